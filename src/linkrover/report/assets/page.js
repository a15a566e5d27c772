"use strict";
// Draws each figure when it comes into view, and links a run's time series with its map: hover one, see the other.
const figures = JSON.parse(document.getElementById("figures").textContent);
const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] };
const drawn = new Map();

function draw(element) {
  if (!drawn.has(element.id)) {
    const figure = figures[element.id];
    drawn.set(element.id, Plotly.newPlot(element, figure.data, figure.layout, config).then(() => link(element)));
  }
  return drawn.get(element.id);
}

function partner(element, suffix) {
  const other = document.getElementById(element.id.replace(/-(series|map)$/, "-" + suffix));
  return other && drawn.has(other.id) ? other : null;
}

function nearest(path, t) {
  let low = 0, high = path.t.length - 1;
  while (high - low > 1) {
    const mid = (low + high) >> 1;
    if (path.t[mid] < t) low = mid; else high = mid;
  }
  return t - path.t[low] < path.t[high] - t ? low : high;
}

function link(element) {
  const path = figures[element.id].path;
  if (element.id.endsWith("-series") && path) {
    element.on("plotly_hover", (event) => {
      const map = partner(element, "map");
      const t = event.points.length ? event.points[0].x : null;
      if (!map || t === null) return;
      const at = nearest(path, t);
      const cursor = map.data.length - 1;
      Plotly.restyle(map, { x: [[path.x[at]]], y: [[path.y[at]]] }, [cursor]);
      map.dataset.cursor = t;
    });
  }
  if (element.id.endsWith("-map")) {
    element.on("plotly_hover", (event) => {
      const series = partner(element, "series");
      const t = event.points.length ? event.points[0].customdata : undefined;
      if (!series || t === undefined) return;
      const outages = figures[series.id].layout.shapes || [];
      const cursor = { type: "line", xref: "x", yref: "paper", x0: t, x1: t, y0: 0, y1: 1, line: { color: "#1b1f24", width: 1.5 } };
      Plotly.relayout(series, { shapes: outages.concat([cursor]) });
      series.dataset.cursor = t;
    });
  }
}

const watcher = new IntersectionObserver((entries) => {
  for (const entry of entries) if (entry.isIntersecting) { watcher.unobserve(entry.target); draw(entry.target); }
}, { rootMargin: "600px" });
const all = Array.from(document.querySelectorAll(".figure"));
all.forEach((element) => watcher.observe(element));
window.addEventListener("beforeprint", () => all.forEach(draw));

// Every table can be taken along as CSV.
for (const button of document.querySelectorAll("button.csv")) {
  button.addEventListener("click", () => {
    const table = document.getElementById(button.dataset.table);
    const rows = Array.from(table.rows).map((row) => Array.from(row.cells)
      .map((cell) => '"' + cell.textContent.trim().replaceAll('"', '""') + '"').join(","));
    const a = document.createElement("a");
    a.href = URL.createObjectURL(new Blob([rows.join("\r\n") + "\r\n"], { type: "text/csv" }));
    a.download = button.dataset.table + ".csv";
    a.click();
    URL.revokeObjectURL(a.href);
  });
}
