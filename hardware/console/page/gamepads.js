// Which gamepad drives: the first one of the standard layout that is used, until it is unplugged.
"use strict";

const DEAD_ZONE = 0.08, TOUCHED = 0.3;
const PAD = {stop: 1, ahead: 7, back: 6, steering: 0, roll: 2, pitch: 3};

function connectedGamepads() {
  return navigator.getGamepads ? [...navigator.getGamepads()].filter((pad) => pad && pad.connected) : [];
}

// Buttons and axes of another layout have no known places: none of them may drive, or count as the stop.
const isStandard = (pad) => pad.mapping === "standard";
const isTouched = (pad) => pad.buttons.some((button) => button.pressed || button.value > TOUCHED)
  || pad.axes.some((axis) => Math.abs(axis) > TOUCHED);

class Gamepads {
  constructor() {
    this.held = null;  // {index, id} of the one that drives
    this.standard = [];
    this.other = [];
  }

  // Looks anew; whether the one that drove has gone.
  look() {
    const found = connectedGamepads();
    this.standard = found.filter(isStandard);
    this.other = found.filter((pad) => !isStandard(pad));
    const gone = Boolean(this.held) && !this.driver();
    if (gone) this.held = null;
    const first = this.standard.length === 1 ? this.standard[0] : this.standard.find(isTouched);
    if (!this.held && first) this.held = {index: first.index, id: first.id};
    return gone;
  }

  // As it is now, or null.
  driver() {
    return this.standard.find((pad) => pad.index === this.held?.index && pad.id === this.held.id) ?? null;
  }

  // Number of them on which the stop is pressed: one with a stuck button leaves the others theirs.
  get stopsPressed() {
    return this.standard.filter((pad) => pad.buttons[PAD.stop]?.pressed).length;
  }

  words(hasTail) {
    const sticks = `left stick steers, triggers drive, ${hasTail ? "right stick moves the tail, " : ""}B stops`;
    const driver = this.driver();
    const ignored = this.standard.filter((pad) => pad !== driver);
    const lines = driver ? [`${driver.id}: ${sticks}`]
      : ignored.length ? [`${ignored.length} gamepads: the first one that is touched drives`] : ["no gamepad that can drive: press a button on it"];
    if (driver) for (const pad of ignored) lines.push(`ignored: ${pad.id} (its button B stops)`);
    for (const pad of this.other) lines.push(`${pad.id} has no standard layout: not used, and its buttons do not stop the car`);
    return lines.join("\n");
  }
}

// Values of the sliders from a gamepad of the standard layout; null if its axes are no numbers.
function gamepadValues(pad, rows) {
  const axis = (index) => {
    const value = pad.axes[index] ?? 0;
    return Math.abs(value) < DEAD_ZONE ? 0 : value;
  };
  const pressed = (index) => pad.buttons[index]?.value ?? 0;
  const values = {
    throttle: pressed(PAD.ahead) - pressed(PAD.back),
    steering: -axis(PAD.steering) * rows.steering.channel.limit,
    pitch: -axis(PAD.pitch) * rows.pitch.channel.limit,
    roll: axis(PAD.roll) * rows.roll.channel.limit,
  };
  return Object.values(values).every(Number.isFinite) ? values : null;
}
