// A figure of panels in a grid, as Matplotlib laid it out: drag to zoom, double-click for the whole.
function drawFigure(figure, data) {
  const place = figure.querySelector(".charts");
  const group = chartGroup((holder) => Number(holder.dataset.height));
  function element(tag, name, words, parent) {
    const made = document.createElement(tag);
    made.className = name;
    made.textContent = words;
    parent.append(made);
    return made;
  }
  if (data.title) { element("p", "title", data.title, place); }
  if (data.keys.length) {
    const keys = element("p", "keys", "", place);
    for (const key of data.keys) {
      const entry = element("span", "", "", keys), canvas = element("canvas", "", "", entry);
      [canvas.width, canvas.height] = [56, 32];
      const context = canvas.getContext("2d");
      context.strokeStyle = key.colour;
      context.fillStyle = key.fill || "transparent";
      context.lineWidth = 2 * (key.width || 1);
      if (key.joined) {
        context.setLineDash((key.dash || []).map((length) => 2 * length));
        context.beginPath(); context.moveTo(0, 16); context.lineTo(56, 16); context.stroke();
      }
      if (key.mark) {
        context.setLineDash([]);
        disc(context, 28, 16, Math.min(2 * key.size, 26)); context.fill(); context.stroke();
      }
      entry.append(key.label);
    }
  }
  const grid = element("div", "grid", "", place);
  // Panels wrap where names of ticks and 200 px of chart do not fit side by side; a grid with holes stays as it is.
  const wraps = data.cells.every((cell, index) => cell.row * data.columns + cell.column === index);
  const narrowest = 200 + Math.max(...data.cells.flatMap((cell) => cell.panels.map((panel) => acrossNames(panel.y_ticks))));
  grid.style.gridTemplateColumns = wraps
    ? `repeat(auto-fit, minmax(min(100%, max(${narrowest}px, ${Math.floor(90 / data.columns)}%)), 1fr))`
    : `repeat(${data.columns}, minmax(0, 1fr))`;
  for (const cell of data.cells) {
    const box = element("div", "cell", "", grid);
    if (!wraps) { box.style.gridArea = `${cell.row + 1} / ${cell.column + 1}`; }
    for (const panel of cell.panels) {
      if (panel.title) { element("p", "title", panel.title, box); }
      if (panel.note) { element("p", "note", panel.note, box); }
      const holder = element("div", "", "", box);
      holder.dataset.height = panel.height;
      const chart = group.add(holder, panel, {
        legend: { show: panel.series.length > 0 },
        cursor: { drag: { x: true, y: true, uni: 24 }, bind: { dblclick: (chart) => () => group.restore(chart) } },
      }, panel.linked);
      group.restore(chart);
    }
  }
  figure.classList.add("drawn");
  return group;
}
const figures = [...document.querySelectorAll("figure.interactive")].map((figure) =>
  drawFigure(figure, JSON.parse(figure.querySelector("script").textContent)));
