// Strips of the last seconds on a canvas: one or two lines, told apart by dashes and by name.
"use strict";

const PLOT_SECONDS = 10;
const DEGREES = 180 / Math.PI;

class StripPlot {
  // lines: [{name, key, scale, digits, ofTail}]; least: half height of the scale that is always shown.
  constructor(place, title, unit, lines, least) {
    this.title = title;
    this.unit = unit;
    this.lines = lines;
    this.least = least;
    this.samples = [];
    const figure = document.createElement("figure");
    figure.className = lines.every((line) => line.ofTail) ? "plot of-tail" : "plot";
    const caption = document.createElement("figcaption");
    const name = document.createElement("span");
    name.textContent = `${title}, ${unit}`;
    this.value = document.createElement("b");
    caption.append(name, this.value);
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${title} of the last ${PLOT_SECONDS} s, ${unit}; the newest value stands above`);
    figure.append(caption, this.canvas);
    place.append(figure);
    this.figure = figure;
  }

  // A box that shows and hides the plot; a hidden one goes on listening.
  makeSwitch() {
    const label = document.createElement("label"), box = document.createElement("input");
    label.className = this.figure.classList.contains("of-tail") ? "check of-tail" : "check";
    Object.assign(box, {type: "checkbox", checked: true, name: "plotted", value: this.title});
    box.addEventListener("change", () => { this.figure.hidden = !box.checked; });
    label.append(box, ` ${this.title}`);
    return label;
  }

  add(time, report) {
    const values = this.lines.map((line) => (report && report[line.key] !== null ? report[line.key] * line.scale : NaN));
    this.samples.push([time, ...values]);
    while (this.samples[0][0] < time - PLOT_SECONDS) this.samples.shift();
    this.value.textContent = this.lines
      .map((line, i) => `${line.name} ${Number.isNaN(values[i]) ? "–" : values[i].toFixed(line.digits ?? 1)}`)
      .join(" · ");
  }

  draw(now) {
    if (this.figure.hidden) return;
    const ratio = window.devicePixelRatio || 1;
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    if (this.canvas.width !== Math.round(width * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    const pen = this.canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const span = this.span();
    const left = 40, y = (value) => height / 2 - (value / span) * (height / 2 - 8);
    const x = (time) => width - ((now - time) / PLOT_SECONDS) * (width - left);
    this.grid(pen, left, width, height, span, y);
    this.lines.forEach((_, index) => {
      pen.beginPath();
      pen.setLineDash(index ? [6, 4] : []);
      pen.strokeStyle = index ? "#a34700" : "#0059a8";
      pen.lineWidth = 1.8;
      let drawing = false;
      for (const sample of this.samples) {
        const value = sample[index + 1];
        if (Number.isNaN(value) || x(sample[0]) < left) { drawing = false; continue; }
        if (drawing) pen.lineTo(x(sample[0]), y(value)); else pen.moveTo(x(sample[0]), y(value));
        drawing = true;
      }
      pen.stroke();
    });
    pen.setLineDash([]);
  }

  span() {
    let most = this.least;
    for (const sample of this.samples) for (const value of sample.slice(1)) if (Math.abs(value) > most) most = Math.abs(value);
    const unit = 10 ** Math.floor(Math.log10(most));
    return unit * [1, 2, 5, 10].find((factor) => factor * unit >= most * 0.999);
  }

  grid(pen, left, width, height, span, y) {
    pen.fillStyle = "#4a5463";
    pen.strokeStyle = "#d5dae0";
    pen.lineWidth = 1;
    pen.font = "11px system-ui, sans-serif";
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const value of [-span, 0, span]) {
      pen.beginPath();
      pen.moveTo(left, y(value));
      pen.lineTo(width, y(value));
      pen.stroke();
      pen.fillText(String(+value.toPrecision(3)), left - 5, y(value));
    }
  }
}

function makePlots(place, channels) {
  const plots = [
    new StripPlot(place, "Speed", "m/s", [{name: "", key: "speed", scale: 1, digits: 2}], 2),
    new StripPlot(place, "Yaw rate", "rad/s", [{name: "", key: "yaw_rate", scale: 1, digits: 2}], 1),
    new StripPlot(place, "Roll of the car", "°", [{name: "", key: "roll", scale: DEGREES}], 5),
    new StripPlot(place, "Tail angle", "°", [
      {name: "roll (solid)", key: "tail_roll", scale: DEGREES, ofTail: true}, {name: "pitch (dashed)", key: "tail_pitch", scale: DEGREES, ofTail: true}], 100),
    new StripPlot(place, "Tail torque", "N m", [
      {name: "roll (solid)", key: "torque_roll", scale: 1, ofTail: true}, {name: "pitch (dashed)", key: "torque_pitch", scale: 1, ofTail: true}], 5),
  ];
  for (const plot of plots) channels.append(plot.makeSwitch());
  return plots;
}
