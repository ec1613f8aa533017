"""The bar below a replay: play and pause, a time slider, the rate, and the numbers of the moment shown.

The script of the page drives Meshcat's animator itself, so that a page that holds two replays can show both at the same
time: it calls `replay.follow()` once and then `replay.show(seconds)` of each.
"""

import json
from collections.abc import Mapping
from typing import Any

RATES = (0.1, 0.25, 0.5, 1.0)
"""Rates that the bar offers, seconds of the replay per second."""

CONTROLS_STYLE = """
<style>
  .replay-bar { position: fixed; left: 16px; right: 16px; bottom: 14px; display: flex; gap: 12px; align-items: center;
                padding: 8px 14px; font: 15px/1.4 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #1c2430;
                background: rgba(255, 255, 255, 0.88); border-radius: 6px; }
  .replay-bar[hidden] { display: none; }
  .replay-bar button, .replay-bar select { font: inherit; padding: 3px 10px; border: 1px solid #56606e;
                border-radius: 4px; background: #fff; color: inherit; }
  .replay-bar button { min-width: 5.2em; }
  .replay-bar input { flex: 1; min-width: 6em; accent-color: #0072B2; }
  .replay-bar :focus-visible { outline: 3px solid #0072B2; outline-offset: 2px; }
  .following #run h1, .following #run .key { display: none; }
  .replay-bar output { font-variant-numeric: tabular-nums; white-space: pre; }
</style>
"""

CONTROLS_SCRIPT = """
<script>
  // A clock of its own: `show` is told the seconds since the beginning, for ever anew from 0 to `duration`.
  function replayClock(bar, duration, show) {
    const [button, slider, rate, output] = ["button", "input", "select", "output"].map((tag) => bar.querySelector(tag));
    let time = 0, playing = true, last = performance.now();
    slider.max = duration;
    function draw() {
      slider.value = time;
      output.textContent = `${time.toFixed(2)} of ${duration.toFixed(2)} s`;
      show(time);
    }
    function play(on) {
      playing = on;
      last = performance.now();
      button.textContent = on ? "Pause" : "Play";
    }
    function tick(now) {
      if (playing) {
        time = (time + Math.max(0, now - last) / 1000 * Number(rate.value)) % duration;
        draw();
      }
      last = now;
      requestAnimationFrame(tick);
    }
    button.addEventListener("click", () => play(!playing));
    slider.addEventListener("input", () => { play(false); time = Number(slider.value); draw(); });
    play(true);
    requestAnimationFrame(tick);
    return { play, get time() { return time; } };
  }
</script>
"""

_PAGE_SCRIPT = """
<script>
  const replay = (() => {
    const run = RUN_DATA;
    const bar = document.getElementById("replay-bar");
    const now = document.getElementById("run-now");
    const animator = typeof viewer === "undefined" ? undefined : viewer.animator;
    if (!animator || !document.createElement("canvas").getContext("webgl2")) {
      now.textContent = "This browser shows no 3D pictures (WebGL is off): the run cannot be drawn.";
      bar.hidden = true;
      return { duration: 0, show() {}, follow() {} };
    }
    const number = (value, digits, width) => value.toFixed(digits).padStart(width, "\\u2007");
    const duration = (run.time.length - 1) / run.frames_per_second;
    let shown = -1, following = false;
    function show(seconds) {
      if (animator.playing) { animator.pause(); }
      animator.seek(Math.min(seconds, duration));
      animator.display_progress(Math.min(seconds, duration));
      const frame = Math.min(Math.max(Math.round(seconds * run.frames_per_second), 0), run.time.length - 1);
      if (frame === shown) { return; }
      shown = frame;
      now.textContent = `t = ${number(run.time[frame], 2, 5)} s   ` +
        `${number(run.speed[frame], 2, 5)} m/s   roll ${number(run.roll[frame], 1, 6)}\\u00b0`;
    }
    const clock = replayClock(bar, duration, (seconds) => { if (!following) { show(seconds); } });
    function follow() {
      following = true;
      bar.hidden = true;
      document.body.classList.add("following");
      clock.play(false);
    }
    return { duration, show, follow, get time() { return clock.time; } };
  })();
</script>
"""


def controls_bar(identity: str = "replay-bar", rate: float = 1.0, first: bool = False) -> str:
    """The bar as HTML; everything in it is reached by the keyboard alone.

    Args:
        identity: of the element in its page.
        rate: selected at first; one of `RATES`.
        first: the Tab key comes to it before all else on the page, such as Meshcat's own panel of dozens of fields.
    """
    order = ' tabindex="1"' if first else ""
    options = "".join(
        f'<option value="{value:g}"{" selected" if value == rate else ""}>{value:g} ×</option>' for value in RATES
    )
    return (
        f'<div class="replay-bar" id="{identity}" role="group" aria-label="Replay">'
        f'<button type="button"{order}>Pause</button>'
        f'<input type="range" min="0" max="1" step="0.01" value="0" aria-label="Time of the replay, s"{order}>'
        f'<select aria-label="Rate of the replay"{order}>{options}</select><output></output></div>'
    )


def page_controls(data: Mapping[str, Any]) -> str:
    """Bar and script of the page of one run.

    Args:
        data: `frames_per_second`, and per frame `time` (s), `speed` (m/s) and `roll` (degrees).
    """
    script = _PAGE_SCRIPT.replace("RUN_DATA", json.dumps(data))
    return CONTROLS_STYLE + controls_bar(first=True) + CONTROLS_SCRIPT + script
