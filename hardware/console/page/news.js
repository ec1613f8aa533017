// How old what the console said is, by the page's own clock: a console that stalls cannot make its last word look new.
"use strict";

const OLD = 0.5;  // s after which nothing that was said is shown as if it were so now
const FORGET = 1e-3;  // s per s; far above the drift between two clocks of one computer

class News {
  constructor() { this.forget(); }

  // A state with the console's time (s). The quickest way here seen so far counts as none, and is forgotten slowly.
  hear(state, now) {
    const way = now - state.time;
    this.way = Math.min(way, this.way + FORGET * (now - this.heard));
    this.state = state;
    this.heard = now;
    this.made = now - (way - this.way);
  }

  forget() {
    this.state = null;
    this.way = Infinity;
    this.heard = this.made = 0;
  }

  age(now) {
    return this.state ? Math.max(0, now - this.made) : Infinity;
  }

  // The state, or null when it is old.
  current(now) {
    return this.age(now) <= OLD ? this.state : null;
  }

  // The car's report, or null when that or the state is old.
  report(now) {
    const radio = this.current(now)?.radio;
    return radio?.heard && radio.report_age + this.age(now) <= OLD ? radio.report : null;
  }
}
