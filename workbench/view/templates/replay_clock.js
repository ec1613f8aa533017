// A clock of its own: `show` is told the seconds since the beginning, for ever anew from 0 to `duration`. The clock waits
// until `loaded()`: Meshcat loads its animation late, and starts it from 0 by itself.
function replayClock(bar, duration, show, loaded = () => true) {
  const [button, slider, rate, output] = ["button", "input", "select", "output"].map((tag) => bar.querySelector(tag));
  let time = 0, playing = true, waiting = true, last = performance.now();
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
  function seek(seconds) {
    play(false);
    time = Math.min(Math.max(seconds, 0), duration);
    draw();
  }
  function tick(now) {
    if (playing && !waiting) {
      time = (time + Math.max(0, now - last) / 1000 * Number(rate.value)) % duration;
      draw();
    } else if (waiting && loaded()) {
      waiting = false;
      draw();
    }
    last = now;
    requestAnimationFrame(tick);
  }
  button.addEventListener("click", () => play(!playing));
  slider.addEventListener("input", () => seek(Number(slider.value)));
  play(true);
  requestAnimationFrame(tick);
  return { play, seek, get time() { return time; } };
}
