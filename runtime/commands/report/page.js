"use strict";
// Plays a session: arm, plots, lanes and readout at one moment; filters its records. What a log says is text, never markup.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const by = (name) => document.getElementById(name);
  const make = (name, text, ...classes) => {
    const element = document.createElement(name);
    if (text !== undefined) element.textContent = text;
    element.classList.add(...classes);
    return element;
  };
  const night = window.matchMedia("(prefers-color-scheme: dark)");
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const LINES = [[], [8, 3], [3, 3], [10, 3, 2, 3], [2, 5], [12, 6], [6, 2, 2, 2, 2, 2], [1, 3], [14, 3], [4, 8], [9, 9]];
  const DAY = ["#00224e", "#b3541e", "#0b57d0", "#6a6a6a", "#8c6d00", "#7b2d8b", "#00695c", "#a1003c", "#35456c", "#555", "#222"];
  const DUSK = ["#fee838", "#ff8a4c", "#8ab4f8", "#c3c8d0", "#e5cf52", "#d7a6ff", "#6fd6c4", "#ff9db8", "#aea371", "#bbb", "#eee"];
  let session = null;
  let view = null;
  let plots = [];
  let now = 0;
  let playing = null;
  let printing = false;

  // ------------------------------------------------------------ the moment

  function nearest(sorted, value) {
    let [low, high] = [0, sorted.length - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (sorted[middle] <= value) low = middle;
      else high = middle;
    }
    return value - sorted[low] <= sorted[high] - value ? low : high;
  }
  function stateAt(lane, at) {
    const span = (lane.spans || []).filter((one) => one.from_s <= at).pop();
    return span ? span.state : "not known";
  }
  function show(at) {
    now = Math.min(Math.max(at, 0), session.end);
    by("moment").value = now;
    by("moment").setAttribute("aria-valuetext", `${now.toFixed(2)} s`);
    if (session.arm && view) view.moment(nearest(session.arm.t, now));
    for (const { plot, one, time } of plots) {
      if (!time) continue;
      plot.setLegend({ idx: nearest(one.x, now) });
      plot.redraw(false);
    }
    const mark = by("now");
    if (mark) mark.setAttribute("d", `M${across(now)} 0V${mark.dataset.height}`);
    readout();
  }
  function readout() {
    const rows = [["time", `${now.toFixed(2)} s of ${session.end.toFixed(2)} s`]];
    for (const lane of session.lanes) if (lane.spans) rows.push([lane.name, stateAt(lane, now)]);
    for (const one of session.plots) {
      if (one.axis !== "s") continue;
      const k = nearest(one.x, now);
      for (const series of one.series) {
        const value = now < one.x[0] - 0.05 || now > one.x[one.x.length - 1] + 0.5 ? null : series.values[k];
        rows.push([series.name, value === null || value === undefined ? "not known" : `${value.toFixed(2)} ${one.unit}`]);
      }
    }
    by("readout").replaceChildren(...rows.map(([name, value]) => {
      const row = make("tr");
      const head = make("th", name);
      head.scope = "row";
      row.append(head, make("td", value));
      return row;
    }));
  }
  function play() {
    if (playing) {
      window.clearInterval(playing);
      playing = null;
    } else {
      if (now >= session.end) show(0);
      const step = still ? 0.5 : 0.05;
      const factor = Math.max(1, session.end / 60);
      playing = window.setInterval(() => {
        show(now + step * factor);
        if (now >= session.end) play();
      }, step * 1000);
    }
    by("playing").textContent = playing ? "Pause" : "Play";
  }

  // ------------------------------------------------------------ lanes

  const LEFT = 90;
  const ROW = 26;
  const PAPER = 700;
  let wide = PAPER;
  const across = (at) => (LEFT + (at / Math.max(session.end, 1e-9)) * (wide - LEFT - 2)).toFixed(1);
  const lettersWide = (text) => [...text].reduce((sum, letter) => sum + (letter === letter.toLowerCase() ? 7 : 9), 0);
  // 1, 2 or 5 of a power of ten: at least as much as asked for.
  function roundStep(least) {
    const ten = 10 ** Math.floor(Math.log10(least));
    return [1, 2, 5, 10].map((one) => one * ten).find((one) => one >= least * 0.999);
  }
  function drawLanes() {
    const svg = by("lanes");
    wide = Math.max(printing ? PAPER : svg.clientWidth || PAPER, LEFT + 100);
    const draw = (name, attributes, text) => {
      const element = document.createElementNS("http://www.w3.org/2000/svg", name);
      for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
      if (text !== undefined) element.textContent = text;
      return element;
    };
    const parts = [];
    session.lanes.forEach((lane, row) => {
      const y = row * ROW;
      parts.push(draw("text", { x: 0, y: y + 16, class: "lane" }, lane.name));
      for (const span of lane.spans || []) {
        const [x, end] = [Number(across(span.from_s)), Number(across(span.to_s))];
        const box = draw("rect", { x, y: y + 2, width: Math.max(end - x, 0.8), height: 19, class: `span ${span.kind}` });
        box.append(draw("title", {}, `${span.state}, ${span.from_s.toFixed(3)} to ${span.to_s.toFixed(3)} s`));
        box.addEventListener("click", () => show(span.from_s));
        parts.push(box);
        if (end - x > lettersWide(span.state) + 8) parts.push(draw("text", { x: x + 4, y: y + 16, class: "state" }, span.state));
      }
      for (const mark of lane.marks || []) {
        const x = Number(across(mark.t_s));
        const shape = mark.kind === "bad" ? `M${x - 5} ${y + 6}l10 10m0 -10l-10 10` : `M${x} ${y + 4}l6 7-6 7-6-7Z`;
        const sign = draw("path", { d: shape, class: `mark ${mark.kind}` });
        sign.append(draw("title", {}, `${mark.text}, ${mark.t_s.toFixed(3)} s`));
        sign.addEventListener("click", () => {
          show(mark.t_s);
          if (mark.card) by(mark.card).scrollIntoView();
        });
        parts.push(sign);
      }
    });
    const height = session.lanes.length * ROW;
    const step = roundStep((session.end * 70) / (wide - LEFT));
    const digits = Math.max(0, -Math.floor(Math.log10(step)));
    for (let k = 0; k * step <= session.end * 1.0001; k += 1) {
      const x = Number(across(k * step));
      parts.push(draw("path", { d: `M${x} ${height}v5`, class: "tick" }));
      const last = wide - x < 40;
      parts.push(draw("text", { x, y: height + 18, class: "lane", "text-anchor": last ? "end" : "middle" }, `${(k * step).toFixed(digits)}${k ? "" : " s"}`));
    }
    svg.setAttribute("viewBox", `0 0 ${wide} ${height + 22}`);
    parts.push(draw("path", { id: "now", d: "", "data-height": height }));
    svg.replaceChildren(...parts);
  }

  // ------------------------------------------------------------ plots

  function drawPlots() {
    for (const { plot } of plots) plot.destroy();
    plots = [];
    const holder = by("plots");
    holder.replaceChildren();
    const dark = night.matches && !printing;
    const [ink, grid, colours] = dark ? ["#eceff3", "#3a424c", DUSK] : ["#16181d", "#dfe3e8", DAY];
    for (const one of session.plots) {
      const figure = make("figure");
      figure.append(make("figcaption", one.title.includes(one.unit) ? one.title : `${one.title}, ${one.unit}`));
      const box = make("div", undefined, "plot");
      figure.append(box);
      holder.append(figure);
      const time = one.axis === "s";
      const series = [{ label: time ? "s" : "mm along the path" }];
      const columns = [one.x];
      one.series.forEach((line, k) => {
        series.push({ label: line.name, stroke: colours[k % colours.length], width: 1.6, dash: LINES[k % LINES.length], points: { show: one.x.length < 60, size: 4 } });
        columns.push(line.values);
      });
      const bound = dark ? "#ff8a4c" : "#c23b00";
      for (const line of one.lines) {
        // Drawn over the whole width, not only where there are samples.
        series.push({ label: line.name, stroke: bound, width: 2, dash: [6, 4], points: { show: false }, paths: () => null });
        columns.push(one.x.map(() => line.value));
      }
      const axis = { stroke: ink, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1 }, font: "12px system-ui, sans-serif" };
      const plot = new drawing.uPlot({
        width: box.clientWidth || 560,
        height: 210,
        scales: { x: { time: false, range: time ? [0, session.end] : undefined } },
        series,
        axes: [{ ...axis, label: time ? "s" : "mm along the path", labelSize: 20, labelFont: axis.font }, { ...axis, size: 56 }],
        cursor: { sync: time ? { key: "time" } : undefined, drag: { setScale: false, x: false, y: false } },
        hooks: {
          draw: [(drawn) => {
            const { ctx, bbox } = drawn;
            const stroke = (colour, dash, from, to) => {
              ctx.setLineDash(dash);
              ctx.strokeStyle = colour;
              ctx.beginPath();
              ctx.moveTo(...from);
              ctx.lineTo(...to);
              ctx.stroke();
            };
            ctx.save();
            ctx.lineWidth = 2;
            for (const line of one.lines) {
              const y = drawn.valToPos(line.value, "y", true);
              stroke(bound, [6, 4], [bbox.left, y], [bbox.left + bbox.width, y]);
            }
            const x = drawn.valToPos(now, "x", true);
            if (time) stroke(ink, [], [x, bbox.top], [x, bbox.top + bbox.height]);
            ctx.restore();
          }],
          setCursor: [(drawn) => {
            if (!time && view && session.place) view.point(drawn.cursor.idx === null || drawn.cursor.idx === undefined ? null : nearest(session.place.length, one.x[drawn.cursor.idx]));
          }],
        },
      }, columns, box);
      plot.over.addEventListener("click", () => {
        if (time && plot.cursor.idx !== null) show(one.x[plot.cursor.idx]);
      });
      if (!time) plot.setLegend({ idx: lowest(one) });
      plots.push({ plot, one, box, time });
    }
  }
  // Where the least of all values is.
  function lowest(one) {
    let [at, least] = [0, Infinity];
    for (const { values } of one.series) {
      values.forEach((value, k) => {
        if (value !== null && value < least) [at, least] = [k, value];
      });
    }
    return at;
  }
  function resize() {
    drawLanes();
    show(now);
    const width = (box) => (printing ? Math.min(box.clientWidth, 330) : box.clientWidth) || 560;
    for (const { plot, box } of plots) plot.setSize({ width: width(box), height: 210 });
    if (view) view.resize();
  }

  // ------------------------------------------------------------ records and frames

  const SHOWN = 300;
  function filter() {
    const words = by("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const topic = by("topic").value;
    const { columns, rows } = session.records;
    const which = columns.indexOf("topic");
    const found = rows.filter((row) => (!topic || row[which] === topic) && words.every((word) => row.join(" ").toLowerCase().includes(word)));
    by("count").textContent = `${found.length} of ${rows.length} records${found.length > SHOWN ? `, the first ${SHOWN} are shown` : ""}`;
    by("rows").replaceChildren(...found.slice(0, SHOWN).map((row) => {
      const line = make("tr");
      for (const cell of row) line.append(make("td", cell === null ? "" : String(cell)));
      return line;
    }));
  }
  function records() {
    const { columns, rows } = session.records;
    by("columns").replaceChildren(...columns.map((name) => {
      const cell = make("th", name);
      cell.scope = "col";
      return cell;
    }));
    const which = columns.indexOf("topic");
    const topics = [...new Set(rows.map((row) => row[which]).filter(Boolean))].sort();
    by("topic").replaceChildren(new Option("every topic", ""), ...topics.map((topic) => new Option(topic, topic)));
    filter();
  }
  function frames() {
    for (const one of data.sessions) {
      for (const [card, lines] of Object.entries(one.frames)) {
        const holder = document.querySelector(`.frames[data-card="${card}"]`);
        if (!holder) continue;
        const details = make("details");
        const text = make("pre", lines.join("\n"));
        text.tabIndex = 0;
        details.append(make("summary", lines.length ? `${lines.length} messages on the bus around it` : "No message on the bus around it"), text);
        holder.replaceChildren(details);
      }
    }
  }

  // ------------------------------------------------------------ begin

  function look() {
    if (view) view.dispose();
    view = null;
    by("view3d").hidden = false;
    try {
      if (!session.place && !session.arm) throw new Error("nothing to draw");
      const asked = document.createElement("canvas").getContext("webgl2");
      if (!asked) throw new Error("no WebGL");
      asked.getExtension("WEBGL_lose_context")?.loseContext();
      view = view3d(by("view3d"), session, night.matches && !printing);
    } catch (reason) {
      by("view3d").hidden = true;
      by("looks").hidden = true;
      by("no3d").hidden = false;
      by("no3d").textContent = session.place || session.arm ? "No three-dimensional view here (no WebGL): the pictures below show the same place." : "This log holds no path and no arm to draw.";
    }
  }
  // The place that is nearest to a limit, and if the arm came there, when; false where there is no view to show it in.
  function closest(number) {
    if (number !== data.sessions.indexOf(session)) {
      by("session").value = number;
      begin(number);
    }
    if (!view || !session.place || !session.place.ratio.length) return false;
    const { ratio, wrist } = session.place;
    const k = ratio.reduce((least, value, at) => ((value ?? Infinity) < (ratio[least] ?? Infinity) ? at : least), 0);
    const at = wrist.slice(3 * k, 3 * k + 3);
    view.toPlace(...at);
    view.point(k);
    if (session.arm) {
      const away = session.arm.t.map((_, m) => Math.hypot(...at.map((value, axis) => session.arm.points[12 * m + 6 + axis] - value)));
      const when = away.indexOf(Math.min(...away));
      if (away[when] < REACHED_MM) show(session.arm.t[when]);
    }
    by("play").scrollIntoView({ behavior: still ? "auto" : "smooth" });
    return true;
  }
  const REACHED_MM = 25;
  function begin(number) {
    session = data.sessions[number];
    by("moment").max = session.end;
    by("moment").step = Math.max(session.end / 2000, 0.001);
    look();
    drawLanes();
    drawPlots();
    records();
    by("moments").replaceChildren(...session.moments.map((one) => {
      const button = make("button", `${one.name}: ${one.t_s.toFixed(2)} s`);
      button.type = "button";
      button.addEventListener("click", () => show(one.t_s));
      return button;
    }));
    show(session.arm ? session.arm.t[0] : 0);
  }
  for (const element of document.querySelectorAll(".needs-script")) element.hidden = false;
  const choice = by("session");
  data.sessions.forEach((one, number) => choice.append(new Option(one.name, number)));
  by("choice").hidden = data.sessions.length < 2;
  choice.addEventListener("change", () => begin(Number(choice.value)));
  by("moment").addEventListener("input", () => show(Number(by("moment").value)));
  by("playing").addEventListener("click", play);
  by("whole").addEventListener("click", () => view && view.whole());
  by("near").addEventListener("click", () => view && view.toPath());
  by("filter").addEventListener("input", filter);
  by("topic").addEventListener("change", filter);
  document.addEventListener("keydown", (event) => {
    if (event.target.matches("input, select, textarea, button, summary, pre, a")) return;
    if (event.key === " ") {
      event.preventDefault();
      play();
    } else if (event.key === "/") {
      event.preventDefault();
      by("filter").focus();
    }
  });
  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[data-at]");
    if (link) show(Number(link.dataset.at));
    const nearestLimit = event.target.closest('#top a[href^="#place"]');
    if (nearestLimit && closest(Number(nearestLimit.hash.replace("#place", "")))) event.preventDefault();
  });
  const again = () => {
    const at = now;
    look();
    drawPlots();
    show(at);
  };
  night.addEventListener("change", again);
  window.addEventListener("resize", resize);
  window.addEventListener("beforeprint", () => {
    printing = true;
    again();
    resize();
  });
  window.addEventListener("afterprint", () => {
    printing = false;
    again();
  });
  frames();
  begin(0);
})();
