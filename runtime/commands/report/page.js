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
    return span ? span.state : "";
  }
  function show(at) {
    now = Math.min(Math.max(at, 0), session.end);
    by("moment").value = now;
    by("moment").setAttribute("aria-valuetext", `${now.toFixed(2)} s`);
    if (session.arm && view) view.moment(nearest(session.arm.t, now));
    for (const { plot, time } of plots) if (time) plot.redraw(false);
    const mark = by("now");
    if (mark) mark.setAttribute("d", `M${place(now)} 0V${mark.dataset.height}`);
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
  const place = (at) => (LEFT + (at / Math.max(session.end, 1e-9)) * (1000 - LEFT)).toFixed(1);
  function drawLanes() {
    const svg = by("lanes");
    const draw = (name, attributes, text) => {
      const element = document.createElementNS("http://www.w3.org/2000/svg", name);
      for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
      if (text !== undefined) element.textContent = text;
      return element;
    };
    const parts = [];
    session.lanes.forEach((lane, row) => {
      const y = row * 26;
      parts.push(draw("text", { x: 0, y: y + 16, class: "lane" }, lane.name));
      for (const span of lane.spans || []) {
        const [x, end] = [Number(place(span.from_s)), Number(place(span.to_s))];
        const box = draw("rect", { x, y: y + 2, width: Math.max(end - x, 0.8), height: 19, class: `span ${span.kind}` });
        box.append(draw("title", {}, `${span.state}, ${span.from_s.toFixed(3)} to ${span.to_s.toFixed(3)} s`));
        box.addEventListener("click", () => show(span.from_s));
        parts.push(box);
        if (end - x > span.state.length * 6.6 + 6) parts.push(draw("text", { x: x + 4, y: y + 16, class: "state" }, span.state));
      }
      for (const mark of lane.marks || []) {
        const x = Number(place(mark.t_s));
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
    const height = session.lanes.length * 26;
    svg.setAttribute("viewBox", `0 0 1000 ${height}`);
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
      figure.append(make("figcaption", `${one.title}, ${one.unit}`));
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
      for (const line of one.lines) {
        series.push({ label: line.name, stroke: dark ? "#ff8a4c" : "#c23b00", width: 2, dash: [6, 4], points: { show: false } });
        columns.push(one.x.map(() => line.value));
      }
      const axis = { stroke: ink, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1 }, font: "12px system-ui, sans-serif" };
      const plot = new drawing.uPlot({
        width: box.clientWidth || 560,
        height: 210,
        scales: { x: { time: false } },
        series,
        axes: [{ ...axis, label: time ? "s" : "mm along the path", labelSize: 20, labelFont: axis.font }, { ...axis, size: 56 }],
        cursor: { sync: time ? { key: "time" } : undefined, drag: { setScale: false, x: false, y: false } },
        hooks: {
          draw: [(drawn) => {
            if (!time) return;
            const x = drawn.valToPos(now, "x", true);
            drawn.ctx.save();
            drawn.ctx.setLineDash([]);
            drawn.ctx.strokeStyle = ink;
            drawn.ctx.lineWidth = 2;
            drawn.ctx.beginPath();
            drawn.ctx.moveTo(x, drawn.bbox.top);
            drawn.ctx.lineTo(x, drawn.bbox.top + drawn.bbox.height);
            drawn.ctx.stroke();
            drawn.ctx.restore();
          }],
          setCursor: [(drawn) => {
            if (!time && view && session.place) view.point(drawn.cursor.idx === null || drawn.cursor.idx === undefined ? null : nearest(session.place.length, one.x[drawn.cursor.idx]));
          }],
        },
      }, columns, box);
      plot.over.addEventListener("click", () => {
        if (time && plot.cursor.idx !== null) show(one.x[plot.cursor.idx]);
      });
      plots.push({ plot, box, time });
    }
  }
  let printing = false;
  function resize() {
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
