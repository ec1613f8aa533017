// Signals of one or several runs over one time: chosen channels, zoom, and a cursor that is the time of a replay.
// `seek` is called with a time when the cursor is dragged; `moveTo` draws the cursor where the replay is.
function runSignals(root, data, seek) {
  const find = (name) => root.querySelector(`.${name}`);
  const single = data.runs.length === 1;
  const chosen = new Set(data.chosen), hidden = new Set();
  const group = chartGroup(() => 128);
  const numbers = new Map();
  let panels = [], now = data.span[0], window = data.span.slice();

  function decoded(text) {
    if (!numbers.has(text)) {
      const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
      numbers.set(text, Array.from(new Float32Array(bytes.buffer), (value) => (Number.isFinite(value) ? value : null)));
    }
    return numbers.get(text);
  }
  const timesOf = (run) => decoded(data.runs[run].time);
  function valuesOf(channel, run) {
    const held = channel.values[run];
    if (held === null) { return null; }
    return typeof held === "number" ? timesOf(run).map(() => held) : decoded(held);
  }
  function element(tag, words, parent, attributes = {}) {
    const made = document.createElement(tag);
    made.textContent = words;
    for (const [name, value] of Object.entries(attributes)) { made.setAttribute(name, value); }
    parent.append(made);
    return made;
  }

  // Of one run, what measures the same stands in one panel; of several runs each channel has its own.
  function groups() {
    const found = new Map();
    for (const channel of data.channels.filter((one) => chosen.has(one.name))) {
      const key = single ? `${channel.family} ${channel.unit}` : channel.name;
      found.set(key, [...(found.get(key) || []), channel]);
    }
    return [...found.values()];
  }

  function seriesOf(channels) {
    const series = [];
    channels.forEach((channel, place) => data.runs.forEach((run, index) => {
      const values = valuesOf(channel, index);
      if (values === null || hidden.has(index)) { return; }
      const look = data.looks[(single ? place : index) % data.looks.length];
      series.push({ label: single ? channel.name : run.name, meaning: channel.meaning, x: timesOf(index), y: values,
                    digits: digitsOf(values), ...look });
    }));
    return series;
  }

  // Decimals that tell a thousandth of the largest value.
  function digitsOf(values) {
    const largest = values.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
    return largest > 0 ? Math.min(Math.max(2 - Math.floor(Math.log10(largest)), 0), 9) : 0;
  }

  function draw() {
    group.clear();
    const place = find("panels");
    place.textContent = "";
    panels = groups().map((channels) => {
      const box = element("figure", "", place), unit = channels[0].unit;
      const heading = element("figcaption", "", box);
      const series = seriesOf(channels);
      if (!single) { element("b", `${channels[0].meaning}${unit ? ` [${unit}]` : ""} `, heading, { title: channels[0].name }); }
      const readouts = single || series.length <= 6 ? series.map((one) => {
        const entry = element("span", "", heading, { title: one.meaning });
        element("i", "", entry, { style: `border-top: 3px ${one.dash ? "dashed" : "solid"} ${one.colour}` });
        element("span", ` ${one.label} `, entry);
        return element("output", "", entry);
      }) : [];
      if (single && unit) { element("span", `[${unit}]`, heading); }
      const shapes = data.turn ? [{ x: [data.turn[0], data.turn[1], data.turn[1], data.turn[0]],
                                    y: ["low", "low", "high", "high"], fill: data.shade }] : [];
      const panel = { x_range: null, series, shapes, x_label: "", y_label: "" };
      if (!series.length) { panel.x_range = window; panel.y_range = [0, 1]; }
      const holder = element("div", "", box, { role: "img", "aria-label": `${channels[0].meaning} over time` });
      const chart = group.add(holder, panel, { legend: { show: false }, padding: [6, 10, 0, 0], cursor: cursor() });
      worked(chart);
      return { chart, series, readouts };
    });
    find("none").hidden = panels.length > 0;
    zoomTo(...window);
    moveTo(now);
  }

  // The mouse moves the cursor of the replay; with Shift it marks a stretch to zoom to.
  function cursor() {
    let marking = false;
    const wrapped = (before) => (chart, target, handle) => (event) => { if (before(event)) { handle(event); } return null; };
    return { y: false, points: { show: false }, drag: { x: true, y: false, setScale: true },
      bind: {
        mousedown: wrapped((event) => (marking = event.shiftKey && event.button === 0)),
        mousemove: wrapped(() => marking),
        mouseup: wrapped(() => { const was = marking; marking = false; return was; }),
        mouseleave: wrapped(() => marking), mouseenter: wrapped(() => marking), dblclick: () => () => zoomTo(...data.span),
      } };
  }

  function worked(chart) {
    const over = chart.over;
    const timeAt = (event) => chart.posToVal(event.clientX - over.getBoundingClientRect().left, "x");
    const inSpan = (time) => Math.min(Math.max(time, data.span[0]), data.span[1]);
    let dragging = false;
    over.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || event.shiftKey) { return; }
      dragging = true;
      over.setPointerCapture(event.pointerId);
      seek(inSpan(timeAt(event)));
    });
    over.addEventListener("pointermove", (event) => { if (dragging) { seek(inSpan(timeAt(event))); } });
    for (const end of ["pointerup", "pointercancel"]) { over.addEventListener(end, () => { dragging = false; }); }
    over.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.shiftKey) { return; }
      event.preventDefault();
      scaleAround(timeAt(event), event.deltaY + event.deltaX > 0 ? 1.25 : 0.8);
    }, { passive: false });
    chart.hooks.setScale.push((changed, scale) => {
      if (scale === "x") { window = [changed.scales.x.min, changed.scales.x.max]; queueMicrotask(() => moveTo(now)); }
    });
  }

  function zoomTo(from, to) {
    window = [from, to];
    group.zoom(from, to);
  }
  function scaleAround(time, factor) {
    const whole = data.span[1] - data.span[0];
    const width = Math.min(Math.max((window[1] - window[0]) * factor, whole / 2000), whole);
    const share = Math.min(Math.max((time - window[0]) / (window[1] - window[0]), 0), 1);
    const from = Math.min(Math.max(time - share * width, data.span[0]), data.span[1] - width);
    zoomTo(from, from + width);
  }

  function nearest(times, time) {
    let low = 0, high = times.length - 1;
    while (high - low > 1) { const middle = (low + high) >> 1; if (times[middle] > time) { high = middle; } else { low = middle; } }
    return time - times[low] < times[high] - time ? low : high;
  }
  function moveTo(time) {
    now = time;
    for (const { chart, series, readouts } of panels) {
      const inside = time >= window[0] && time <= window[1];
      chart.setCursor({ left: inside ? chart.valToPos(time, "x") : -10, top: 0 }, false);
      readouts.forEach((readout, index) => {
        const { x, y } = series[index];
        const value = time > x[x.length - 1] + 1e-6 ? null : y[nearest(x, time)];
        readout.textContent = value === null ? "–" : value.toFixed(series[index].digits).replace("-", "\u2212");
      });
    }
  }

  function list() {
    const place = find("channels");
    for (const channel of data.channels) {
      const label = element("label", "", place);
      const box = element("input", "", label, { type: "checkbox", value: channel.name });
      box.checked = chosen.has(channel.name);
      const words = element("span", ` ${channel.meaning}${channel.unit ? ` [${channel.unit}]` : ""} `, label);
      if (channel.meaning !== channel.name) { element("code", channel.name, words); }
      box.addEventListener("change", () => { chosen[box.checked ? "add" : "delete"](channel.name); draw(); });
    }
    find("filter").addEventListener("input", (event) => {
      const words = event.target.value.toLowerCase().split(/\s+/);
      for (const label of place.children) {
        label.hidden = !words.every((word) => label.textContent.toLowerCase().includes(word));
      }
    });
    find("closer").addEventListener("click", () => scaleAround(now, 0.5));
    find("wider").addEventListener("click", () => scaleAround(now, 2));
    find("whole").addEventListener("click", () => zoomTo(...data.span));
  }
  list();
  draw();
  return { moveTo, zoomTo, get time() { return now; }, get window() { return window; }, get charts() { return group.charts; },
           showRun(run, on) { hidden[on ? "delete" : "add"](run); draw(); } };
}
