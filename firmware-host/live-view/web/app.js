// The page: shows what comes over the link, and gives orders.

import { Link } from "./link.js";
import { MapView } from "./map.js";
import * as messages from "./messages.js";
import { showHealth } from "./health.js";
import { Hand } from "./hand.js";
import { Fence } from "./fence.js";

// Older data is not the robot's state any more. Ticks come ten times a second.
const STALE_MS = 800;
const LOOK_EVERY_MS = 100;
// A connection that stays silent is opened again.
const RESTART_MS = 4000;
const MOST_EVENTS = 60;

const $ = (id) => document.getElementById(id);
const state = { open: false, wasOpen: false, robot: null, heard: performance.now(), role: "watch", urls: {}, shown: {} };

const map = new MapView($("map"), (place) => (fence.draws ? fence.tap(place) : ask(place)));
$("map").addEventListener("follows", () => $("follow").setAttribute("aria-pressed", String(map.follows)));

function show(id, bytes) {
  const url = URL.createObjectURL(new Blob([messages.image(bytes)], { type: "image/jpeg" }));
  $(id).src = url;
  if (state.urls[id]) URL.revokeObjectURL(state.urls[id]);
  state.urls[id] = url;
  state.shown[id] = performance.now();
}

const readers = {
  "/robot/now": (bytes) => now(messages.json(bytes)),
  "/robot/health": (bytes) => health(messages.json(bytes)),
  "/tf": (bytes) => {
    const laser = messages.laser(bytes);
    if (laser) map.laser = laser;
  },
  "/scan": (bytes) => map.set({ scan: messages.scan(bytes) }),
  "/map": (bytes) => map.setGrid(messages.grid(bytes)),
  "/keep_out": (bytes) => {
    const { keep_out: closed = [], keep_in: allowed = [] } = messages.areas(bytes);
    map.set({ closed, allowed });
    $("open-areas").hidden = closed.length === 0;
  },
  "/path": (bytes) => map.set({ path: messages.path(bytes) }),
  "/camera/image": (bytes) => show("camera", bytes),
  "/depth/image": (bytes) => show("depth", bytes),
  "/events": (bytes, timeMs) => event(messages.log(bytes), timeMs),
};

function now(message) {
  state.heard = performance.now();
  state.now = message;
  setText("why", message.why);
  const rotates = message.angular_radps && !message.linear_mps;
  const speed = rotates ? `${Math.abs((message.angular_radps * 180) / Math.PI).toFixed(0)} °/s` : `${(message.linear_mps ?? 0).toFixed(2)} m/s`;
  const facts = [speed, `(${message.x_m?.toFixed(1)}, ${message.y_m?.toFixed(1)}) m`, `${message.run_s.toFixed(0)} s`];
  setText("facts", facts.join("  \u00b7  "));
  const goal = message.goal ? { x: message.goal.x_m, y: message.goal.y_m } : null;
  map.set({ pose: { x: message.x_m, y: message.y_m, yaw: (message.yaw_deg * Math.PI) / 180 }, goal });
  document.querySelector("[data-order=arm]").classList.toggle("next", message.needs_person);
  document.querySelector("[data-order=resume]").classList.toggle("next", message.stands && !message.needs_person);
  look();
}

function health(message) {
  showHealth($("health-list"), message);
  // Not while a person chooses.
  const { policy } = message.exploration;
  if (policy && document.activeElement !== $("policy")) $("policy").value = policy;
}

// Screen readers speak a text again when it is set again.
function setText(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

function event({ level, message }, timeMs) {
  const line = document.createElement("li");
  line.className = level >= 4 ? "error" : level === 3 ? "warning" : "info";
  const time = document.createElement("time");
  time.textContent = new Date(timeMs).toLocaleTimeString("en-GB");
  line.append(time, message);
  $("events").prepend(line);
  while ($("events").children.length > MOST_EVENTS) $("events").lastChild.remove();
}

function ageText(id) {
  const ms = performance.now() - (state.shown[id] ?? performance.now());
  return ms > 1500 ? `(${(ms / 1000).toFixed(0)} s old)` : "";
}

// Says whether the data is live. Called with every tick and ten times a second.
function look() {
  const age = performance.now() - state.heard;
  const stale = !state.open || state.robot !== null || age > STALE_MS;
  document.body.classList.toggle("stale", stale);
  const chip = $("link");
  chip.className = stale ? "chip bad" : "chip live";
  setText("link", !stale ? "live" : state.wasOpen ? "lost" : "connecting");
  $("lost").hidden = !stale || (!state.wasOpen && age < STALE_MS);
  if (stale) setText("lost", lostText(age));
  setText("camera-age", ageText("camera"));
  setText("depth-age", ageText("depth"));
  if (state.open && age > RESTART_MS && state.robot === null) {
    state.heard = performance.now() - STALE_MS;
    link.restart();
  }
}

function lostText(age) {
  const since = `for ${(age / 1000).toFixed(0)} s`;
  if (!state.wasOpen) return "No link to live-view. If it needs a token, add #token=TOKEN to the address.";
  if (!state.open) return `The link to live-view is lost ${since}. The robot continues without it; STOP does not reach the robot from here.`;
  if (state.robot) return `No robot: ${state.robot}. STOP does not reach it from here.`;
  return `The robot has sent nothing ${since}. What is shown is old.`;
}
setInterval(look, LOOK_EVERY_MS);

async function order(name, request) {
  const answer = await link.call(`/robot/${name}`, request);
  showAnswer(name, answer);
}

function showAnswer(name, answer) {
  const line = $("answer");
  line.classList.toggle("no", !answer.accepted);
  line.textContent = `${name.replaceAll("_", " ")}: ${answer.text}`;
}

$("stop").addEventListener("click", () => order("stop"));
for (const button of document.querySelectorAll("[data-order]")) {
  button.addEventListener("click", () => order(button.dataset.order));
}
$("go-to").addEventListener("submit", (event) => {
  event.preventDefault();
  order("go_to", { x_m: $("go-x").valueAsNumber, y_m: $("go-y").valueAsNumber });
});

// A tap asks first: a finger that only wanted to move the map must not send the robot.
function ask(place) {
  if (state.role !== "steer") return;
  map.set({ asked: place });
  setText("ask-text", `Go to (${place.x.toFixed(1)}, ${place.y.toFixed(1)}) m?`);
  $("ask").hidden = false;
  $("ask-go").focus();
}
function closeAsk() {
  $("ask").hidden = true;
  map.set({ asked: null });
}
$("ask").addEventListener("submit", (event) => {
  event.preventDefault();
  if (map.asked) order("go_to", { x_m: map.asked.x, y_m: map.asked.y });
  closeAsk();
});
$("ask-cancel").addEventListener("click", closeAsk);

$("policy").addEventListener("change", async () => {
  await order("explore_by", { policy: $("policy").value });
  $("policy").blur();
});

const hand = new Hand($("pad"), async (forward, left) => {
  const { most_mps, most_radps } = state.now ?? { most_mps: 0, most_radps: 0 };
  const velocity = { linear_mps: forward * most_mps, angular_radps: left * most_radps };
  const answer = await link.call("/robot/drive", velocity);
  if (!answer.accepted) showAnswer("drive", answer);
});
$("hand").addEventListener("click", () => {
  hand.setActive(!hand.active);
  $("hand").setAttribute("aria-pressed", String(hand.active));
  $("hand-part").hidden = !hand.active;
});

const fence = new Fence($("fence"), map, (corners) => order("keep_out", { corners_m: corners.map(({ x, y }) => [x, y]) }));
$("fence").addEventListener("draws", () => $("draw").setAttribute("aria-pressed", String(fence.draws)));
$("draw").addEventListener("click", () => {
  closeAsk();
  if (fence.draws) fence.end();
  else fence.begin();
});
$("open-areas").addEventListener("click", () => {
  fence.end();
  order("open_areas");
});

$("follow").addEventListener("click", () => map.setFollows(!map.follows));
$("zoom-in").addEventListener("click", () => map.zoom(1.25));
$("zoom-out").addEventListener("click", () => map.zoom(0.8));

document.addEventListener("keydown", (event) => {
  // Escape stops wherever the focus is.
  if (event.key === "Escape") {
    closeAsk();
    hand.release();
    order("stop");
    return;
  }
  if (hand.takes(event.key) || event.target.matches("input, select") || event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
  // No key arms the robot: the same keys drive it by hand, and a person may not notice that this mode has ended.
  const keys = { p: "pause", r: "resume" };
  if (keys[event.key] && state.role === "steer") order(keys[event.key]);
  if (event.key === "f") map.setFollows(!map.follows);
});

// The token is in the part of the address that browsers send to no server.
function address() {
  const url = new URL(location.href);
  const token = new URLSearchParams(url.hash.slice(1)).get("token");
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  url.hash = "";
  url.search = token ? `?token=${encodeURIComponent(token)}` : "";
  return url.href;
}

const link = new Link(address(), readers, {
  open(role) {
    state.open = state.wasOpen = true;
    state.role = role;
    for (const part of document.querySelectorAll(".steer")) part.hidden = role !== "steer";
    $("watching").hidden = role === "steer";
    look();
  },
  closed() {
    state.open = false;
    hand.release();
    look();
  },
  status(text, isRobot) {
    if (isRobot) state.robot = text;
    else $("answer").textContent = text;
    look();
  },
});
