"use strict";
// Courses over time: drag to zoom, double-click for the whole drive, point for values, buttons hide traces; arrows, + and - by keyboard.
for (const figure of document.querySelectorAll("figure.course")) {
  const told = JSON.parse(figure.querySelector("script").textContent);
  const colours = ["#c4621a", "#2f7fc1", "#3b8f4e", "#8f5fbf", "#b03060", "#8a7a10"];
  const panes = [...new Set(told.traces.map(t => t.pane))];
  const seen = panes.map(() => 0);
  const traces = told.traces.map(t => {
    const codes = new Int16Array(Uint8Array.from(atob(t.data), c => c.charCodeAt(0)).buffer);
    const pane = panes.indexOf(t.pane);
    const value = i => codes[i] === -32768 ? NaN : t.middle + t.step * codes[i];
    return { name: t.name, pane, value, size: codes.length, on: true, colour: t.truth ? "" : colours[seen[pane]++ % 6] };
  });
  const [left, high, gap, foot] = [58, 130, 26, 34];
  let view = [told.from, told.to], cursor = null, from = null;
  const canvas = document.createElement("canvas"), bar = document.createElement("div");
  bar.className = "legend";
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", figure.querySelector("svg").getAttribute("aria-label") + ", to be zoomed");
  const button = (text, act) => {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.addEventListener("click", () => { act(made); draw(); });
    bar.append(made);
    return made;
  };
  for (const t of traces) {
    t.button = button(t.name, made => { t.on = !t.on; made.setAttribute("aria-pressed", t.on); });
    t.button.setAttribute("aria-pressed", true);
    t.button.style.borderColor = t.colour || "currentColor";
  }
  button("whole drive", () => { view = [told.from, told.to]; });
  const values = document.createElement("span");
  bar.append(values);
  const time = x => view[0] + (view[1] - view[0]) * Math.min(1, Math.max(0, (x - left) / (canvas.clientWidth - left - 6)));
  const index = (t, at) => Math.min(t.size - 1, Math.max(0, Math.floor((at - told.from) / (told.to - told.from) * t.size)));
  const ticks = (low, top, most) => {
    const rough = (top - low) / most, power = 10 ** Math.floor(Math.log10(rough));
    const step = power * ([1, 2, 5].find(m => m * power >= rough) || 10);
    const first = Math.ceil(low / step);
    return Array.from({ length: Math.floor(top / step) - first + 1 }, (_, i) => Number(((first + i) * step).toPrecision(6)));
  };
  function draw() {
    const wide = canvas.clientWidth, ratio = devicePixelRatio || 1, tall = panes.length * (high + gap) + foot - gap;
    canvas.style.height = tall + "px";
    canvas.width = wide * ratio;
    canvas.height = tall * ratio;
    const ink = getComputedStyle(figure).color, pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "11px sans-serif";
    const x = at => left + (at - view[0]) / (view[1] - view[0]) * (wide - left - 6);
    panes.forEach((name, p) => {
      const top = p * (high + gap) + 14, shown = traces.filter(t => t.pane === p && t.on);
      const ends = [Infinity, -Infinity];
      for (const t of shown) for (let i = index(t, view[0]); i <= index(t, view[1]); i++) {
        const v = t.value(i);
        if (v < ends[0]) ends[0] = v;
        if (v > ends[1]) ends[1] = v;
      }
      if (!(ends[1] > ends[0])) { const at = ends[0] < Infinity ? ends[0] : 0; ends[0] = at - 1; ends[1] = at + 1; }
      const y = v => top + high - 14 - (v - ends[0]) / (ends[1] - ends[0]) * (high - 14);
      pen.fillStyle = pen.strokeStyle = ink;
      pen.fillText(name, left, top - 4);
      pen.lineWidth = 0.3;
      const line = (a, b, c, d) => { pen.beginPath(); pen.moveTo(a, b); pen.lineTo(c, d); pen.stroke(); };
      pen.textAlign = "right";
      for (const v of ticks(ends[0], ends[1], 6)) { line(left, y(v), wide - 6, y(v)); pen.fillText(v, left - 5, y(v) + 4); }
      pen.textAlign = "center";
      for (const at of ticks(view[0], view[1], 8)) {
        line(x(at), top, x(at), top + high - 14);
        if (p === panes.length - 1) pen.fillText(at, x(at), top + high + 2);
      }
      pen.textAlign = "left";
      pen.save();
      pen.beginPath();
      pen.rect(left, top - 2, wide - left - 6, high - 10);
      pen.clip();
      for (const t of shown) {
        pen.strokeStyle = t.colour || ink;
        pen.lineWidth = 1;
        pen.beginPath();
        let broken = true;
        for (let i = Math.max(0, index(t, view[0]) - 1); i <= Math.min(t.size - 1, index(t, view[1]) + 1); i++) {
          const v = t.value(i);
          if (Number.isNaN(v)) { broken = true; continue; }
          const at = x(told.from + (i + 0.5) * (told.to - told.from) / t.size);
          if (broken) pen.moveTo(at, y(v)); else pen.lineTo(at, y(v));
          broken = false;
        }
        pen.stroke();
      }
      pen.strokeStyle = ink;
      pen.lineWidth = 0.8;
      if (cursor !== null) line(x(cursor), top, x(cursor), top + high);
      if (cursor !== null && from !== null) { pen.globalAlpha = 0.15; pen.fillRect(x(from), top, x(cursor) - x(from), high); }
      pen.restore();
    });
    pen.fillStyle = ink;
    pen.textAlign = "center";
    pen.fillText("time [s]", (wide + left) / 2, tall - 4);
    figure.dataset.view = view.map(t => t.toFixed(1)).join(" ");
    values.textContent = cursor === null ? "" : `${cursor.toFixed(2)} s: ` + traces.filter(t => t.on).map(t => {
      const i = index(t, cursor) & ~1, v = (t.value(i) + t.value(Math.min(i + 1, t.size - 1))) / 2;
      return `${t.name} ${Number.isNaN(v) ? "-" : Number(v.toPrecision(4))}`;
    }).join(", ");
  }
  const zoom = (a, b) => {
    const least = (told.to - told.from) / 500, wide = Math.min(told.to - told.from, Math.max(b - a, least));
    const begin = Math.min(Math.max((a + b - wide) / 2, told.from), told.to - wide);
    view = [begin, begin + wide];
    draw();
  };
  canvas.addEventListener("pointerdown", e => { from = time(e.offsetX); canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointermove", e => { cursor = time(e.offsetX); draw(); });
  canvas.addEventListener("pointerleave", () => { cursor = null; draw(); });
  canvas.addEventListener("pointerup", e => {
    const [a, b] = [from, time(e.offsetX)].sort((p, q) => p - q);
    from = null;
    if (b - a > (view[1] - view[0]) / 100) zoom(a, b); else draw();
  });
  canvas.addEventListener("dblclick", () => zoom(told.from, told.to));
  canvas.addEventListener("keydown", e => {
    const wide = view[1] - view[0], middle = (view[0] + view[1]) / 2;
    const by = { ArrowLeft: [-0.25, 1], ArrowRight: [0.25, 1], "+": [0, 0.5], "-": [0, 2] }[e.key];
    if (by) { e.preventDefault(); zoom(middle + wide * (by[0] - by[1] / 2), middle + wide * (by[0] + by[1] / 2)); }
  });
  figure.prepend(bar, canvas);
  figure.classList.add("live");
  draw();
  addEventListener("resize", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
}
