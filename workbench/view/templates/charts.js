// Charts of uPlot from plain panels. Charts of one group share the zoom of the time axis, and what else is linked.
//
// A panel: { title, x_label, y_label, series, shapes, x_range, y_range, x_ticks, y_ticks, note }. A series has
// { label, x, y (null: a gap), colour, dash, width, mark, size, fill, joined }, its x increasing; a shape { x, y, stroke, fill,
// dash, width, mark, size } is drawn below, its x in any order (null: a gap; "low", "high": at the edge of the chart).
// Without a range an axis holds what its series have.
// A page with replays and with plots has this file twice: nothing here is declared by `const` or `let`.
var AXIS = { stroke: "#1c2430", font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif",
             grid: { stroke: "#e2e2e2" }, ticks: { stroke: "#9a9a9a" }, labelSize: 18 };

function disc(context, x, y, size) {
  context.beginPath();
  context.arc(x, y, size / 2, 0, 2 * Math.PI);
  context.closePath();
}

function drawShapes(chart, shapes) {
  const { ctx: context, bbox: box } = chart, ratio = uPlot.pxRatio;
  const across = (x) => (x === null ? NaN : chart.valToPos(x, "x", true));
  const down = (y) => (y === null ? NaN : chart.valToPos(y, "y", true));
  context.save();
  context.beginPath();
  context.rect(box.left, box.top, box.width, box.height);
  context.clip();
  for (const shape of shapes) {
    const edges = { x: [box.left, box.left + box.width], y: [box.top + box.height, box.top] };
    const at = (axis, value, place) => (value === "low" ? edges[axis][0] : value === "high" ? edges[axis][1] : place(value));
    const points = shape.x.map((x, i) => [at("x", x, across), at("y", shape.y[i], down)]);
    context.strokeStyle = shape.stroke || "transparent";
    context.fillStyle = shape.fill || "transparent";
    context.lineWidth = (shape.width || 1) * ratio;
    context.setLineDash((shape.dash || []).map((length) => length * ratio));
    if (shape.mark) {
      context.setLineDash([]);
      for (const [x, y] of points) {
        if (Number.isNaN(x + y)) { continue; }
        disc(context, x, y, shape.size * ratio);
        context.fill();
        context.stroke();
      }
      continue;
    }
    context.beginPath();
    let open = false;
    for (const [x, y] of points) {
      if (Number.isNaN(x + y)) { open = false; continue; }
      if (open) { context.lineTo(x, y); } else { context.moveTo(x, y); }
      open = true;
    }
    if (shape.fill) { context.fill(); }
    if (shape.stroke) { context.stroke(); }
  }
  context.restore();
}

function axisOf(label, ticks, size) {
  const axis = { ...AXIS, scale: size.scale, label, size: size.across, space: size.space, values: (chart, splits) => splits.map((place) => (place === null ? "" : String(Number(place.toPrecision(6))))) };
  if (!label) { delete axis.label; axis.labelSize = 0; }
  if (ticks) {
    const names = new Map(ticks);
    axis.splits = (chart, index, low, high) => [...names.keys()].filter((place) => place >= low && place <= high);
    axis.values = (chart, splits) => splits.map((place) => names.get(place));
    axis.filter = (chart, splits) => splits;
    axis.space = 1;
  }
  return axis;
}

function longest(ticks) { return Math.max(0, ...(ticks || []).flatMap(([, words]) => words.split("\n").map((line) => line.length))); }

// Width of a vertical axis, px.
function acrossNames(ticks) { return ticks ? 22 + 7 * longest(ticks) : 58; }

// The options of uPlot that all charts have; `own` adds cursor, legend and hooks.
function optionsOf(panel, own) {
  const drawn = panel.series.map((series) => ({
    label: series.label, stroke: series.colour, dash: series.dash, width: series.width || 1.5,
    points: series.mark ? { show: true, size: series.size, fill: series.fill || series.colour, stroke: series.colour } : { show: false },
    ...(series.mark && !series.joined ? { paths: () => null } : {}),
    value: (chart, value) => (value === null || value === undefined ? "–" : Number(value.toPrecision(5)).toString()),
  }));
  const slanted = panel.x_ticks && longest(panel.x_ticks) * panel.x_ticks.length > 60;
  const below = axisOf(panel.x_label, panel.x_ticks,
    { scale: "x", across: slanted ? 24 + 4 * longest(panel.x_ticks) : panel.x_ticks ? 40 : 28, space: 46 });
  if (slanted) { below.rotate = -30; }
  const range = (limits) => (limits ? { range: () => limits.slice().sort((a, b) => a - b) } : {});
  return {
    ...own,
    scales: {
      x: { time: false, range: (chart, low, high) => [low, high], dir: backwards(panel.x_range) },
      y: { ...range(panel.y_range), dir: backwards(panel.y_range) },
    },
    axes: [
      below,
      axisOf(panel.y_label, panel.y_ticks,
        { scale: "y", across: acrossNames(panel.y_ticks), space: 20 }),
    ],
    series: [{ label: panel.x_name || panel.x_label || "x", value: (chart, value) => (value === null ? "–" : Number(value.toPrecision(6)).toString()) },
             ...drawn],
    hooks: { ...own.hooks, drawAxes: [(chart) => drawShapes(chart, panel.shapes || [])] },
  };
}

function backwards(limits) { return limits && limits[0] > limits[1] ? -1 : 1; }

function dataOf(panel) {
  if (!panel.series.length) { return [panel.x_range ? panel.x_range.slice().sort((a, b) => a - b) : [0, 1]]; }
  return uPlot.join(panel.series.map((series) => [series.x, series.y]));
}

// A group of charts: what one is zoomed to along x, those with the same `linked` name are zoomed to.
function chartGroup(height) {
  let charts = [];
  function add(place, panel, own, linked = "all") {
    const width = () => Math.max(place.clientWidth, 160);
    const follow = (chart, scale) => {
      if (scale !== "x") { return; }
      const { min, max } = chart.scales.x;
      for (const other of charts) {
        const [has, others] = [other.chart.scales.x, other.linked === linked && other.chart !== chart];
        if (others && (has.min !== min || has.max !== max)) { other.chart.setScale("x", { min, max }); }
      }
    };
    const chart = new uPlot(optionsOf(panel, { ...own, width: width(), height: height(place),
      hooks: { ...(own.hooks || {}), setScale: [follow] } }), dataOf(panel), place);
    chart.root.querySelectorAll("canvas").forEach((canvas) => canvas.setAttribute("aria-hidden", "true"));
    const watch = new ResizeObserver(() => {
      if (width() !== chart.width) { chart.setSize({ width: width(), height: height(place) }); }
    });
    watch.observe(place);
    charts.push({ chart, panel, linked, watch });
    return chart;
  }
  // The ranges that a chart had at first, and along x those that are linked with it.
  function restore(chart) {
    const limits = (range) => ({ min: Math.min(...range), max: Math.max(...range) });
    const own = charts.find((one) => one.chart === chart);
    chart.setScale("x", limits(own.panel.x_range));
    chart.setScale("y", limits(own.panel.y_range));
  }
  function clear() {
    charts.forEach(({ chart, watch }) => { watch.disconnect(); chart.destroy(); });
    charts = [];
  }
  return { add, clear, restore, zoom(min, max) { charts.forEach(({ chart }) => chart.setScale("x", { min, max })); },
           get charts() { return charts.map(({ chart }) => chart); } };
}
