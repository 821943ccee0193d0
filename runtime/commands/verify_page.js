"use strict";
// Says what limits at the place of the path that is pointed at, and marks it in all views.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const slider = document.getElementById("along");
  const reading = document.getElementById("reading");
  const views = [...document.querySelectorAll("svg.view")];
  const last = data.pose.length - 1;

  const placeOf = (view, k) => (view.dataset.view === "above" ? [data.x[k], data.y[k]] : [Math.hypot(data.x[k], data.y[k]), data.z[k]]);
  function toView(view, [x, y]) {
    const [left, low, span] = view.dataset.window.split(" ").map(Number);
    return [((x - left) / span) * 1000, 1000 - ((y - low) / span) * 1000];
  }
  function show(k) {
    slider.value = k;
    const n = Math.min(k, last - 1);
    const name = data.names[data.limiting[n]];
    const value = data.value[n];
    const kept = value === null ? "nothing is defined here" : `nearest limit ${name.name}: ${value.toFixed(2)} ${name.unit} of ${name.required} required`;
    reading.textContent =
      `Pose ${Math.floor(data.pose[k])}${data.pose[k] % 1 ? " and on" : ""}: wrist centre x ${data.x[k].toFixed(1)}, y ${data.y[k].toFixed(1)}, ` +
      `height ${data.z[k].toFixed(1)} mm; ${kept}`;
    for (const view of views) {
      const [x, y] = toView(view, placeOf(view, k));
      const mark = view.querySelector(".here");
      mark.setAttribute("cx", x);
      mark.setAttribute("cy", y);
      view.classList.add("on");
    }
  }
  for (const view of views) {
    view.addEventListener("pointermove", (event) => {
      const box = view.getBoundingClientRect();
      const x = ((event.clientX - box.left) / box.width) * 1000;
      const y = ((event.clientY - box.top) / box.height) * 1000;
      let best = 0;
      let least = Infinity;
      for (let k = 0; k <= last; k += 1) {
        const [px, py] = toView(view, placeOf(view, k));
        const away = (px - x) ** 2 + (py - y) ** 2;
        if (away < least) [best, least] = [k, away];
      }
      show(best);
    });
  }
  slider.max = last;
  slider.addEventListener("input", () => show(Number(slider.value)));
  document.getElementById("tools").hidden = false;
})();
