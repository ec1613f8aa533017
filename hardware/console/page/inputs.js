// What the operator's hands do with sliders and a step input.
"use strict";

const CHANNELS = [
  {key: "throttle", name: "Throttle", ends: ["back", "ahead"], unit: "%", scale: 100, limit: 1, springs: true},
  {key: "steering", name: "Steering", ends: ["left", "right"], unit: "°", scale: -180 / Math.PI, limit: 0.5, springs: true},
  {key: "pitch", name: "Tail pitch", ends: ["back", "forward"], unit: "°", scale: 180 / Math.PI, limit: 0.5, ofTail: true},
  {key: "roll", name: "Tail roll", ends: ["left", "right"], unit: "°", scale: 180 / Math.PI, limit: 0.5, ofTail: true},
];

// Sliders show per cent and degrees with right positive; values are -1 to 1 and rad with left positive for steering.
class Sliders {
  constructor(place) {
    this.step = null;
    this.rows = {};
    for (const channel of CHANNELS) {
      const row = document.createElement("div");
      row.className = channel.ofTail ? "slider of-tail" : "slider";
      const label = document.createElement("label");
      label.htmlFor = `slider-${channel.key}`;
      label.textContent = channel.name;
      const input = document.createElement("input");
      Object.assign(input, {type: "range", id: label.htmlFor, value: 0, step: 1});
      const output = document.createElement("output");
      output.htmlFor = input.id;
      const ends = document.createElement("div");
      ends.className = "ends";
      ends.setAttribute("aria-hidden", "true");
      for (const end of [channel.ends[0], "0", channel.ends[1]]) ends.append(Object.assign(document.createElement("span"), {textContent: end}));
      row.append(label, input, output, ends);
      place.append(row);
      this.rows[channel.key] = {channel, input, output};
      input.addEventListener("input", () => this.show());
      const letGo = channel.springs ? ["pointerup", "pointercancel", "lostpointercapture"] : [];  // whoever ended it
      for (const end of letGo) input.addEventListener(end, () => { input.value = 0; this.show(); });
    }
    this.setLimits({});
  }

  setLimits(limits) {
    for (const {channel, input} of Object.values(this.rows)) {
      channel.limit = limits[channel.key] ?? channel.limit;
      const most = Math.floor(Math.abs(channel.scale) * channel.limit + 1e-9);
      Object.assign(input, {min: -most, max: most});
    }
    this.show();
  }

  centre() {
    this.step = null;
    for (const {input} of Object.values(this.rows)) input.value = 0;
    this.show();
  }

  // The tail stays where it was asked to be; the car stops and goes straight.
  setDriving(enabled, channels) {
    for (const {channel, input} of Object.values(this.rows)) input.disabled = !enabled || !channels.includes(channel.key);
  }

  startStep(key, size, seconds, now) {
    this.step = {key, value: size / this.rows[key].channel.scale, end: now + seconds};
  }

  set(values) {
    for (const [key, value] of Object.entries(values)) this.rows[key].input.value = value * this.rows[key].channel.scale;
    this.show();
  }

  values(now) {
    if (this.step && now >= this.step.end) this.step = null;
    const values = {};
    for (const {channel, input} of Object.values(this.rows)) {
      let value = Number(input.value) / channel.scale || 0;
      if (this.step && this.step.key === channel.key) value += this.step.value;
      values[channel.key] = Math.max(-channel.limit, Math.min(channel.limit, value));
    }
    return values;
  }

  show() {
    for (const {channel, input, output} of Object.values(this.rows)) {
      const number = Number(input.value);
      const side = number ? ` ${channel.ends[number < 0 ? 0 : 1]}` : "";
      output.textContent = `${Math.abs(number)} ${channel.unit}${side}`;
      input.setAttribute("aria-valuetext", output.textContent);
    }
  }
}
