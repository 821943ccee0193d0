"use strict";
// Draws the map of one yaw and lift, and says what decides at the place that is looked at.
(async () => {
  const at = (id) => document.getElementById(id);
  const packed = Uint8Array.from(atob(at("data").textContent.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const map = JSON.parse(await new Response(stream).text());
  const [px, py, pz] = map.pivot;
  const columns = map.x.length;
  const rows = map.y.length;
  const step = map.step;
  const canvas = at("map");
  const pen = canvas.getContext("2d");
  const whole = document.createElement("canvas");
  const signed = (v) => (v > 0 ? "+" : "") + v;
  let layer = map.first;
  let pinned = cellAt(0, 0);
  let shown = pinned;
  let view;

  // ---- what stands in the data

  // The cell of a displacement, row by row; null outside of the grid.
  function cellAt(x, y) {
    const j = Math.round((x - map.x[0]) / step);
    const i = Math.round((y - map.y[0]) / step);
    return j >= 0 && j < columns && i >= 0 && i < rows ? i * columns + j : null;
  }
  const moveOf = (k) => [map.x[k % columns], map.y[Math.floor(k / columns)]];
  const yawOf = (n) => map.yaw[Math.floor(n / map.lift.length)];
  const liftOf = (n) => map.lift[n % map.lift.length];
  const titleOf = (n) => `yaw ${signed(yawOf(n))}\u00b0, lift ${signed(liftOf(n))} mm`;

  function read(k) {
    const code = map.codes[layer][k];
    const limit = map.limits[Math.floor(code / 4)];
    const clearance = map.clearances[layer][k];
    const value = clearance === null ? null : clearance / 100;
    const ratio = value === null ? null : limit.rate ? (value ? limit.bound / value : null) : value / limit.bound;
    return { admissible: code % 4 > 1, how: code % 4, limit, value, ratio };
  }
  const admissible = (k) => map.codes[layer][k] % 4 > 1;

  // Squares of a kind, each [x, y, side]: the corner with the least x and y, from that of the map.
  function squares(which) {
    const [levels, columnsOf, rowsOf] = map[which][layer].map((steps) => {
      let sum = 0;
      return steps.map((by) => (sum += by));
    });
    return levels.map((level, n) => {
      const side = (map.first_steps * step) / 2 ** level;
      return [columnsOf[n] * side, rowsOf[n] * side, side];
    });
  }
  function best(better) {
    let found = null;
    for (let k = 0; k < rows * columns; k += 1) if (admissible(k) && (found === null || better(k, found))) found = k;
    return found;
  }
  const far = (k) => Math.hypot(...moveOf(k));
  const kept = (k) => Math.round((read(k).ratio ?? 0) * 1000);
  const places = {
    here: () => cellAt(0, 0),
    near: () => best((a, b) => far(a) < far(b)),
    room: () => best((a, b) => kept(a) > kept(b) || (kept(a) === kept(b) && far(a) < far(b))),
  };

  // ---- drawing

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const parts = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
  const scale = map.scale.map(parts);
  // Colours of clearances from 1 deadband to the end of the scale.
  function shade(ratio) {
    const t = Math.min(Math.max((ratio - 1) / (map.top - 1), 0), 1) * (scale.length - 1);
    const k = Math.min(Math.floor(t), scale.length - 2);
    return scale[k].map((v, c) => Math.round(v + (t - k) * (scale[k + 1][c] - v)));
  }

  function extent() {
    const half = step / 2;
    let box = [map.x[0] + px - half, map.x[columns - 1] + px + half, map.y[0] + py - half, map.y[rows - 1] + py + half];
    const add = (x, y) => { box = [Math.min(box[0], x), Math.max(box[1], x), Math.min(box[2], y), Math.max(box[3], y)]; };
    if (at("view").value === "near") {
      const kept = box;
      box = [Infinity, -Infinity, Infinity, -Infinity];
      for (let k = 0; k < rows * columns; k += 1) {
        const [x, y] = moveOf(k);
        if (admissible(k)) { add(x + px - 2 * step, y + py - 2 * step); add(x + px + 2 * step, y + py + 2 * step); }
      }
      if (box[0] < box[1]) return box;
      box = kept;
    }
    for (const arc of map.arcs) for (const [x, y] of arc) add(x, y);
    return box;
  }

  function ticks(low, high, room) {
    const least = (high - low) / Math.max(room / 70, 2);
    const ten = 10 ** Math.floor(Math.log10(least));
    const gap = [1, 2, 5, 10].map((n) => n * ten).find((g) => g >= least);
    const out = [];
    for (let v = Math.ceil(low / gap) * gap; v <= high; v += gap) out.push(Math.round(v * 1000) / 1000);
    return out;
  }

  function draw() {
    const [x0, x1, y0, y1] = extent();
    const edge = { left: 56, right: 10, top: 8, bottom: 46 };
    const wide = canvas.parentElement.clientWidth - edge.left - edge.right;
    const high = Math.max(360, 0.84 * innerHeight) - edge.top - edge.bottom;
    const s = Math.min(wide / (x1 - x0), high / (y1 - y0));
    const width = (x1 - x0) * s;
    const height = (y1 - y0) * s;
    const total = [width + edge.left + edge.right, height + edge.top + edge.bottom];
    const fine = Math.max(devicePixelRatio || 1, 2);
    canvas.width = Math.round(total[0] * fine);
    canvas.height = Math.round(total[1] * fine);
    canvas.style.width = `${total[0]}px`;
    const X = (x) => edge.left + (x - x0) * s;
    const Y = (y) => edge.top + (y1 - y) * s;
    view = { x: (u) => (u - edge.left) / s + x0, y: (v) => y1 - (v - edge.top) / s, X, Y, s, size: total, frame: [edge.left, edge.top, width, height] };
    pen.setTransform(fine, 0, 0, fine, 0, 0);
    pen.fillStyle = colour("--page");
    pen.fillRect(0, 0, ...total);
    pen.save();
    pen.beginPath();
    pen.rect(edge.left, edge.top, width, height);
    pen.clip();
    cells(X, Y);
    letters(X, Y, s, [x0, x1, y0, y1]);
    pen.strokeStyle = colour("--ink");
    pen.lineWidth = 1.6;
    pen.setLineDash([7, 4]);
    for (const arc of map.arcs) {
      pen.beginPath();
      for (const [x, y] of arc) pen.lineTo(X(x), Y(y));
      pen.stroke();
    }
    pen.setLineDash([]);
    sign("column", X(0), Y(0));
    sign("here", X(px), Y(py));
    if (map.move && map.move.yaw === yawOf(layer) && map.move.by[2] === liftOf(layer)) {
      sign("move", X(px + map.move.by[0]), Y(py + map.move.by[1]));
    }
    pen.restore();
    axes([x0, x1, y0, y1], X, Y, edge, width, height);
    [whole.width, whole.height] = [canvas.width, canvas.height];
    whole.getContext("2d").drawImage(canvas, 0, 0);
    mark();
  }

  // The place that is read, over the map as it was drawn: a map may have a hundred thousand cells.
  function mark() {
    pen.drawImage(whole, 0, 0, ...view.size);
    if (shown === null) return;
    const [x, y] = moveOf(shown);
    const size = Math.max(step * view.s, 9);
    pen.save();
    pen.beginPath();
    pen.rect(...view.frame);
    pen.clip();
    for (const [ink, line] of [["#000000", 4], ["#ffffff", 1.8]]) {
      pen.strokeStyle = ink;
      pen.lineWidth = line;
      pen.strokeRect(view.X(x + px) - size / 2, view.Y(y + py) - size / 2, size, size);
    }
    pen.restore();
  }

  const tintsNow = () => map.kinds.map((_, k) => parts(colour(`--k${k}`)));
  const tint = (found, tints) => (found.admissible ? shade(found.ratio ?? map.top) : tints[found.limit.kind]);

  // Positions, one square of the step each, as a picture that is stretched.
  function plain(tints) {
    const out = document.createElement("canvas");
    [out.width, out.height] = [columns, rows];
    const one = out.getContext("2d");
    const image = one.createImageData(columns, rows);
    for (let k = 0; k < rows * columns; k += 1) {
      const to = 4 * ((rows - 1 - Math.floor(k / columns)) * columns + (k % columns));
      image.data.set([...tint(read(k), tints), 255], to);
    }
    one.putImageData(image, 0, 0);
    return out;
  }

  // What is proved of squares, the line about all that is admissible, and hatched what is not decided.
  function cells(X, Y) {
    const tints = tintsNow();
    const [left, low] = [map.x[0] + px - step / 2, map.y[0] + py - step / 2];
    const fine = canvas.width / view.size[0];
    const whole = (v) => Math.round(v * fine) / fine;
    const box = ([x, y, side]) => {
      const [u, v] = [whole(X(left + x)), whole(Y(low + y + side))];
      return [u, v, whole(X(left + x + side)) - u, whole(Y(low + y)) - v];
    };
    const all = [whole(X(left)), whole(Y(low + rows * step))];
    all.push(whole(X(left + columns * step)) - all[0], whole(Y(low)) - all[1]);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(plain(tints), ...all);
    const smaller = squares("squares").map((one, n) => [box(one), read(rows * columns + n)]);
    const fill = (good) => {
      for (const [place, found] of smaller) {
        if (found.admissible !== good) continue;
        pen.fillStyle = `rgb(${tint(found, tints).join(" ")})`;
        pen.fillRect(...place);
      }
    };
    fill(false);
    const unknown = squares("unknown").map(box);
    pen.fillStyle = colour("--page");
    for (const place of unknown) pen.fillRect(...place);
    pen.beginPath();
    for (const place of unknown) pen.rect(...place);
    pen.save();
    pen.clip();
    pen.beginPath();
    for (let u = all[0] - all[3]; unknown.length && u < all[0] + all[2]; u += 4) {
      pen.moveTo(u, all[1] + all[3]);
      pen.lineTo(u + all[3], all[1]);
    }
    pen.strokeStyle = colour("--ink");
    pen.lineWidth = 0.7;
    pen.stroke();
    pen.restore();
    pen.beginPath();
    for (const [place, found] of smaller) if (found.admissible) pen.rect(...place);
    const large = [];
    for (let k = 0; k < rows * columns; k += 1) {
      if (map.cells[layer][k] === "a") large.push([box([(k % columns) * step, Math.floor(k / columns) * step, step]), read(k)]);
    }
    for (const [place] of large) pen.rect(...place);
    pen.lineWidth = 3;
    pen.stroke();
    for (const [place, found] of large) {
      pen.fillStyle = `rgb(${tint(found, tints).join(" ")})`;
      pen.fillRect(...place);
    }
    fill(true);
  }

  function letters(X, Y, s, [x0, x1, y0, y1]) {
    const gap = Math.max(48 / s, step);
    pen.fillStyle = colour("--letter");
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    for (let y = y0 + gap / 2; y < y1; y += gap) {
      for (let x = x0 + gap / 2; x < x1; x += gap) {
        const k = cellAt(x - px, y - py);
        if (k === null || map.cells[layer][k] !== "i") continue;
        const [mx, my] = moveOf(k);
        pen.fillText(map.kinds[read(k).limit.kind], X(mx + px), Y(my + py));
      }
    }
  }

  function sign(name, u, v) {
    const shapes = { column: "M0-6A6 6 0 1 0 0 6A6 6 0 1 0 0-6Z", here: "M-7-4-4-7 0-3 4-7 7-4 3 0 7 4 4 7 0 3-4 7-7 4-3 0Z", move: "M0-9 7 0 0 9-7 0Z" };
    pen.save();
    pen.translate(u, v);
    const path = new Path2D(shapes[name]);
    pen.fillStyle = "#ffffff";
    pen.strokeStyle = "#000000";
    pen.lineWidth = 1.8;
    pen.fill(path);
    pen.stroke(path);
    pen.restore();
  }

  function axes([x0, x1, y0, y1], X, Y, edge, width, height) {
    const [bottom, left] = [edge.top + height, edge.left];
    pen.strokeStyle = pen.fillStyle = colour("--ink");
    pen.lineWidth = 1;
    pen.strokeRect(left, edge.top, width, height);
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (const v of ticks(x0, x1, width)) {
      pen.fillRect(X(v) - 0.5, bottom, 1, 5);
      pen.fillText(v, X(v), bottom + 8);
    }
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const v of ticks(y0, y1, height)) {
      pen.fillRect(left - 5, Y(v) - 0.5, 5, 1);
      pen.fillText(v, left - 8, Y(v));
    }
    const told = `x of the reference point, mm, at lift ${signed(liftOf(layer))} mm`;
    pen.textAlign = "center";
    pen.textBaseline = "top";
    pen.fillText(told, left + width / 2, bottom + 27, width + edge.left);
    pen.save();
    pen.translate(6, edge.top + height / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText("y, mm (robot frame)", 0, 0);
    pen.restore();
  }

  function bar() {
    const strip = at("bar");
    [strip.width, strip.height] = [256, 1];
    for (let k = 0; k < 256; k += 1) {
      strip.getContext("2d").fillStyle = `rgb(${shade(1 + (k / 255) * (map.top - 1)).join(" ")})`;
      strip.getContext("2d").fillRect(k, 0, 1, 1);
    }
  }

  // ---- words

  // What is proved of the square about a position.
  function around(k) {
    const every = { a: "admissible everywhere", i: "inadmissible everywhere", u: "not decided" }[map.cells[layer][k]];
    const size = `${step} mm about it: `;
    if (every) return size + every;
    const [i, j] = [Math.floor(k / columns) * step, (k % columns) * step];
    const within = ([x, y]) => x >= j && x < j + step && y >= i && y < i + step;
    const area = (found) => found.reduce((sum, [, , side]) => sum + (100 * side * side) / (step * step), 0);
    const good = area(squares("squares").filter((one, n) => within(one) && admissible(rows * columns + n)));
    const open = area(squares("unknown").filter(within));
    return `${size}admissible in ${good.toFixed(0)} %, inadmissible in ${(100 - good - open).toFixed(0)} %, not decided in ${open.toFixed(0)} %`;
  }

  function tell() {
    const k = shown;
    at("seen").hidden = k === null;
    if (k === null) return;
    const [x, y] = moveOf(k);
    const found = read(k);
    const value = found.value === null ? "undefined" : `${found.value.toFixed(2)} ${found.limit.unit}`;
    at("verdict").textContent = found.admissible ? "admissible" : "inadmissible";
    at("how").textContent = ["one pose excludes it", "by the certified method", "by the certified method", "proved"][found.how];
    at("limit").textContent = `${found.limit.name}: ${found.limit.words}`;
    at("around").textContent = around(k);
    at("clearance").textContent = `${found.how === 3 ? "at least " : ""}${value}, ${found.limit.bound} ${found.limit.unit} ${found.limit.rate ? "allowed" : "required"}`;
    at("move").textContent = `yaw ${signed(yawOf(layer))}\u00b0, then x ${signed(x)}, y ${signed(y)}, lift ${signed(liftOf(layer))} mm`;
    at("point").textContent = `x ${(x + px).toFixed(1)}, y ${(y + py).toFixed(1)}, z ${(pz + liftOf(layer)).toFixed(1)} mm`;
  }

  function update() {
    const good = map.codes[layer].slice(0, rows * columns).reduce((sum, code) => sum + (code % 4 > 1), 0);
    const lift = liftOf(layer);
    at("lift").textContent = `lift ${signed(lift)} mm`;
    at("heading").textContent = `${titleOf(layer)}: ${good} of ${rows * columns} places admissible`;
    at("height").textContent = map.words[layer % map.lift.length];
    for (const output of document.querySelectorAll("output[for=yaws]")) output.textContent = `${signed(yawOf(layer))}\u00b0`;
    for (const output of document.querySelectorAll("output[for=lifts]")) output.textContent = `${signed(lift)} mm`;
    canvas.setAttribute("aria-label", `Map: ${at("heading").textContent}. Arrow keys move the place that is read.`);
    for (const name of ["near", "room"]) at(name).disabled = good === 0;
    at("view").disabled = good === 0;
    draw();
    tell();
  }

  function look(k) {
    if (k === shown) return;
    shown = k;
    mark();
    tell();
  }

  // ---- what the reader does

  const under = (event) => {
    const box = canvas.getBoundingClientRect();
    const zoom = view.size[0] / box.width;
    return cellAt(view.x((event.clientX - box.left) * zoom) - px, view.y((event.clientY - box.top) * zoom) - py);
  };
  canvas.addEventListener("pointermove", (event) => { if (event.pointerType === "mouse") look(under(event) ?? pinned); });
  canvas.addEventListener("pointerleave", () => look(pinned));
  canvas.addEventListener("click", (event) => { pinned = under(event) ?? pinned; look(pinned); });
  canvas.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] }[event.key];
    if (!by || pinned === null) return;
    event.preventDefault();
    const [x, y] = moveOf(pinned);
    pinned = cellAt(x + by[0] * step, y + by[1] * step) ?? pinned;
    look(pinned);
  });
  for (const name of Object.keys(places)) at(name).addEventListener("click", () => { pinned = places[name](); look(pinned); });
  const [yaws, lifts] = [at("yaws"), at("lifts")];
  [yaws.max, lifts.max] = [map.yaw.length - 1, map.lift.length - 1];
  [yaws.value, lifts.value] = [Math.floor(layer / map.lift.length), layer % map.lift.length];
  for (const input of [yaws, lifts]) {
    input.parentElement.hidden = Number(input.max) === 0;
    input.addEventListener("input", () => { layer = Number(yaws.value) * map.lift.length + Number(lifts.value); update(); });
  }
  at("view").addEventListener("change", draw);
  addEventListener("resize", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  // Paper is light, and takes what the canvas holds.
  addEventListener("beforeprint", () => { document.documentElement.classList.add("paper"); draw(); });
  addEventListener("afterprint", () => { document.documentElement.classList.remove("paper"); draw(); });
  bar();
  at("tools").hidden = false;
  update();
})().catch((error) => {
  document.getElementById("fault").textContent = `This browser cannot draw the map (${error}); the table below says the most of it.`;
});
