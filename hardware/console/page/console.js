// The operator's page. Its heartbeat is made here, in the page's own timer: what stops the page stops the heartbeat.
"use strict";

const BEAT_MS = 50, PAD_MS = 20, LOOK_MS = 100, LATE = 0.2;
const CHANNELS_OF = {rest: [], manual: ["throttle", "steering", "pitch", "roll"], control: ["throttle", "steering"], auto: []};
const NOTES = {
  rest: "Rest: throttle 0. The other modes are free once the car is armed.",
  manual: "Manual: sliders or gamepad move what stands below.",
  control: "Control: you drive; a tail swings by its law.",
  auto: "Auto: the car runs its sequence. Rest ends it.",
};
const TAIL = ["pitch", "roll"];
const get = (id) => document.getElementById(id);
const seconds = () => performance.now() / 1000;
const sliders = new Sliders(get("sliders"));
const plots = makePlots(get("plots"), get("channels"));
const news = new News(), gamepads = new Gamepads();
let socket = null, state = null, count = 0, mode = "rest", padStops = 0, problem = "", failure = "", wasArmed = false, pendingStop = "", pressing = false;

const hasTail = () => state?.radio.report?.has_tail !== false;  // until the car says otherwise
const channels = () => CHANNELS_OF[mode].filter((key) => hasTail() || !TAIL.includes(key));

function send(message) {
  if (!socket || socket.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify(message));
  return true;
}

function stop(by) {
  pendingStop = by;  // until the console says that it has it; sent again when a connection is lost before that
  send({type: "stop", by});
  setMode("rest");
  show();
}

function setMode(wanted) {
  if (wanted === mode) return;
  mode = wanted;
  sliders.centre();
  const seen = news.report(seconds());
  if (mode === "manual" && seen) sliders.set({pitch: seen.tail_pitch ?? 0, roll: seen.tail_roll ?? 0});  // the tail stays
  document.querySelector(`input[name=mode][value=${mode}]`).checked = true;
  get("mode-note").textContent = NOTES[mode];
  show();
}

function beat() {
  if (!state || !state.controls || document.hidden) return;
  count += 1;
  const values = sliders.values(seconds());
  const asked = Object.fromEntries(Object.entries(values).map(([key, value]) => [key, channels().includes(key) ? value : 0]));
  send({type: "beat", count, time: seconds(), mode, ...asked});
}

// -- gamepad

function lookAtGamepads() {
  const gone = gamepads.look(), driver = gamepads.driver(), using = get("use-gamepad");
  const pressed = gamepads.stopsPressed;
  if (pressed > padStops) stop("gamepad");
  padStops = pressed;
  if (using.checked && (gone || !driver)) {
    using.checked = false;
    if (mode !== "rest") {
      setMode("rest");
      problem = "The gamepad that drove was unplugged: the mode is rest.";
    }
  }
  using.disabled = !driver;
  if (using.checked && channels().length) {
    const values = gamepadValues(driver, sliders.rows);
    if (values) sliders.set(values); else setMode("rest");
  }
  setText("gamepad", gamepads.words(hasTail()));
}

// -- connection

async function connect() {
  let answer;
  try {
    answer = await fetch("/console.css", {cache: "no-store"});
  } catch {
    lose("The console does not answer. Is it running?");
    return;
  }
  if (!answer.ok) {
    lose("The console was started again: open the new address that its terminal shows.", false);
    return;
  }
  socket = new WebSocket(`ws://${location.host}/socket`);
  socket.onmessage = (event) => hear(JSON.parse(event.data));
  socket.onclose = () => lose("The connection to the console is lost.");
}

function lose(text, again = true) {
  socket = state = null;
  news.forget();
  problem = failure || text;
  setMode("rest");
  setView("");
  look();
  if (again) setTimeout(connect, 1000);
}

function hear(message) {
  if (message.type === "welcome") {
    problem = failure = "";
    if (pendingStop) send({type: "stop", by: pendingStop});
    sliders.setLimits(message.limits);
    setView(message.view ?? "");
  } else if (message.type === "refused") {
    problem = message.text;
  } else if (message.type === "failed") {
    failure = `The console has failed and ends: ${message.text}. The car is at rest if it could be told. Start the console again.`;
  } else {
    state = message;
    const radio = state.radio, now = seconds();
    news.hear(state, now);
    if (radio.stopped_by) pendingStop = "";
    for (const plot of plots) plot.add(now, news.report(now));
    if (mode !== "rest" && (radio.stopped_by || radio.fault || !state.controls || (wasArmed && !radio.armed))) setMode("rest");
    wasArmed = radio.armed;
  }
  show();
}

// -- what is shown

function setText(id, text) {
  if (get(id).textContent !== text) get(id).textContent = text;
}

// What does not come from the console: time goes by.
function look() {
  const now = seconds();
  if (!news.current(now)) {
    setMode("rest");  // the car has heard nothing from here for longer than it waits
    for (const plot of plots) plot.add(now, null);
  }
  show();
}

function show() {
  const now = seconds(), known = news.current(now), report = news.report(now), radio = known?.radio;
  const controls = Boolean(known?.controls), stopped = Boolean(radio?.stopped_by);
  const armed = Boolean(radio?.armed && report);
  const unknown = !state ? "not connected" : "not known";
  setText("car", !known ? unknown : !report ? "not heard" : report.stopped ? "STOPPED" : armed ? "ARMED" : "not armed");
  get("car-box").className = !known ? "unknown" : report?.stopped ? "stopped" : armed ? "armed" : "";
  setText("heard-mode", report ? report.mode : "–");
  setText("speed", report && report.speed !== null ? `${report.speed.toFixed(2)} m/s` : "–");
  const age = report ? radio.link_age + news.age(now) : null;
  setText("link", age === null ? "no link" : `${Math.round(age * 1000)} ms${age > LATE ? " LATE" : ""}`);
  get("link-box").className = age === null || age > LATE ? "late" : "";
  setText("seat", !known ? unknown : controls ? "controls" : "read-only");
  showFaults(known, report);
  get("stop").classList.toggle("pressed", stopped || Boolean(pendingStop));
  showBanner(known);
  get("take").hidden = !known?.can_take;
  const car = known?.car;
  get("arm").disabled = !controls || !car || car.driving || stopped || mode !== "rest";
  get("disarm").disabled = !controls || !car?.driving;
  get("reset").disabled = !controls || !stopped || mode !== "rest";
  setText("said", !known ? "" : car ? (car.said ? `Drive: ${car.said}` : "Arm starts a drive: it checks the car first.")
    : "This car is armed by the drive on its own computer.");
  for (const input of document.querySelectorAll("input[name=mode]"))
    input.disabled = !controls || stopped || (input.value !== "rest" && !armed && mode === "rest");
  showTail();
  const byPad = get("use-gamepad").checked;
  sliders.setDriving(controls && !byPad, channels());
  get("step-go").disabled = !controls || !channels().includes(stepChannel());
  get("centre").disabled = !controls;
  get("record").disabled = !controls;
  const recording = known?.recording;
  get("record").checked = Boolean(recording?.on);
  setText("record-note", recording ? recording.error || (recording.on ? `writing ${recording.path}` : "") : unknown);
}

function showTail() {
  if (!state || document.body.classList.toggle("tailless", !hasTail()) === false) return;
  if (TAIL.includes(stepChannel())) document.querySelector("input[name=step-channel][value=steering]").checked = true;
}

function showFaults(known, report) {
  const lines = !known ? ["not known: the console is not heard"] : !report ? ["the car is not heard"]
    : report.faults.map((entry) => `${entry.source}: ${entry.fault}`);
  if (report?.text) lines.unshift(report.text);
  if (known?.radio.fault) lines.unshift(`radio of this console: ${known.radio.fault}`);
  const text = lines.length ? lines : ["none"];
  if (get("faults").dataset.text === text.join("\n")) return;
  get("faults").dataset.text = text.join("\n");
  get("faults").replaceChildren(...text.map((line) => Object.assign(document.createElement("li"), {textContent: line})));
}

function bannerText(known) {
  const radio = known?.radio, power = "If the car does not stop, cut its power.";
  if (pendingStop && !state) return `EMERGENCY STOP pressed, but not connected: it is sent when the connection is back. ${power}`;
  if (pendingStop) return `EMERGENCY STOP pressed; the console has not answered yet. ${power}`;
  if (radio?.stopped_by && radio.fault && !radio.confirmed)
    return `EMERGENCY STOP by ${radio.stopped_by} NOT SENT. Cut the car's power. (${radio.fault})`;
  if (radio?.stopped_by) return `EMERGENCY STOP by ${radio.stopped_by}: ${stopText(known, power)}`;
  if (state && !known) {
    const before = state.radio.stopped_by ? ` An emergency stop by ${state.radio.stopped_by} stood before.` : "";
    return `The console has been silent for ${Math.floor(news.age(seconds()))} s: what it showed is old and is not shown. The mode is rest.${before}`;
  }
  if (radio?.fault) return `RADIO FAULT: nothing reaches the car, which stops by itself; the mode is rest. (${radio.fault})`;
  if (problem) return problem;
  return known && !document.hasFocus() ? "This window does not have the keyboard: Escape does not reach it. Click here." : "";
}

function stopText(known, power) {
  if (known.radio.confirmed) return "the car has reported it.";
  if (known.car && !known.car.driving) return "no drive runs, so no car reports it. It stays until it is reset.";
  if (!known.radio.heard) return `the car is not heard, and may have no drive that hears it. It is sent until the car reports it. ${power}`;
  return "sending until the car reports it.";
}

function showBanner(known) {
  const text = bannerText(known);
  if (pressing && !text) return;  // nothing moves under a pointer between press and click
  get("banner").hidden = !text;
  get("banner").className = pendingStop || known?.radio.stopped_by ? "stopped" : "";
  setText("banner", text);
}

function setView(url) {
  get("view").hidden = !url;
  get("show-view").dataset.url = url;
  showView();
}

function showView() {
  const box = get("show-view"), place = get("frame-place");
  place.replaceChildren();
  if (!box.checked || !box.dataset.url) return;
  if (!document.createElement("canvas").getContext("webgl2")) {
    const text = "This browser shows no 3D pictures (WebGL is off). Everything else on this page works without them.";
    place.append(Object.assign(document.createElement("p"), {className: "note", textContent: text}));
    return;
  }
  place.append(Object.assign(document.createElement("iframe"), {src: box.dataset.url, title: "The car in Meshcat", tabIndex: -1}));
}

// -- hands

const stepChannel = () => document.querySelector("input[name=step-channel]:checked").value;

get("stop").addEventListener("pointerdown", (event) => { if (event.button === 0) stop("button"); });
get("stop").addEventListener("click", (event) => { if (event.detail === 0) stop("button"); });  // by keyboard
window.addEventListener("pointerdown", () => { pressing = true; }, {capture: true});
for (const end of ["pointerup", "pointercancel"])
  window.addEventListener(end, () => { pressing = false; }, {capture: true});
window.addEventListener("keydown", (event) => {
  if (event.key !== "Escape" || event.repeat) return;
  event.preventDefault();
  stop("key");
}, {capture: true});
document.addEventListener("visibilitychange", () => {
  if (document.hidden) {
    setMode("rest");
  } else if (state?.controls) {
    problem = "The page was hidden: the heartbeat was off, the mode is rest.";
  }
});
window.addEventListener("blur", () => setTimeout(() => {  // the view must not keep the keyboard from Escape
  if (document.activeElement?.tagName === "IFRAME") { document.activeElement.blur(); window.focus(); }
}));
for (const name of ["arm", "disarm", "reset", "take"])
  get(name).addEventListener("click", () => { problem = pendingStop = ""; send({type: name}); });
get("record").addEventListener("change", (event) => send({type: "log", on: event.target.checked}));
get("centre").addEventListener("click", () => sliders.centre());
get("show-view").addEventListener("change", showView);
get("step-go").addEventListener("click", () =>
  sliders.startStep(stepChannel(), Number(get("step-size").value) || 0, Math.min(Number(get("step-time").value) || 0, Number(get("step-time").max)), seconds()));
for (const input of document.querySelectorAll("input[name=step-channel]"))
  input.addEventListener("change", () => setText("step-unit", stepChannel() === "throttle" ? "%" : "°"));
get("modes").addEventListener("keydown", (event) => {  // an arrow only moves on, Space chooses: the next mode may be AUTO
  const step = {ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1}[event.key];
  if (!step) return;
  event.preventDefault();
  const free = [...document.querySelectorAll("input[name=mode]:enabled")];
  free[(free.indexOf(document.activeElement) + step + free.length) % free.length]?.focus();
});
for (const input of document.querySelectorAll("input[name=mode]"))
  input.addEventListener("change", () => { problem = ""; setMode(input.value); });

setInterval(beat, BEAT_MS);
setInterval(lookAtGamepads, PAD_MS);
setInterval(look, LOOK_MS);
(function draw() {
  for (const plot of plots) plot.draw(seconds());
  setTimeout(() => requestAnimationFrame(draw), 60);
})();
connect();
