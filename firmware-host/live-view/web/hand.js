// Driving by hand with keys, a pad under the finger, or a gamepad. While something is held, ten orders a second are sent; the robot
// stands 0.4 s after the last one, whatever happens to this page or to the link.

const PERIOD_MS = 100;
// Backwards the robot sees less.
const BACKWARDS = 0.5;
// Sticks of gamepads do not return to 0 exactly.
const DEAD_ZONE = 0.12;
const KEYS = { w: [1, 0], s: [-1, 0], a: [0, 1], d: [0, -1] };
// Shoulder buttons and the one below the right thumb, in the standard layout of gamepads.
const HOLD_BUTTONS = [0, 4, 5];

const limited = (value) => Math.max(-1, Math.min(1, value));

export class Hand {
  // `send(forward, left)` gets numbers from -1 to 1.
  constructor(pad, send) {
    Object.assign(this, { pad, send, active: false, keys: new Set(), held: null, drives: false });
    this.listen();
    setInterval(() => this.tick(), PERIOD_MS);
  }

  setActive(active) {
    this.active = active;
    this.release();
  }

  // Lets go of everything.
  release() {
    this.keys.clear();
    this.held = null;
    this.tick();
  }

  // Whether the key is one that drives.
  takes(key) {
    return this.active && key.toLowerCase() in KEYS;
  }

  // The direction that is held: forward and left, each from -1 to 1; null if nothing is.
  direction() {
    if (!this.active) return null;
    const stick = this.stick();
    if (stick) return stick;
    if (this.held) return this.held;
    if (this.keys.size === 0) return null;
    const sum = [...this.keys].map((key) => KEYS[key]).reduce(([f, l], [df, dl]) => [f + df, l + dl], [0, 0]);
    return sum.map(limited);
  }

  // The left stick of a gamepad while one of its buttons is held.
  stick() {
    for (const gamepad of navigator.getGamepads?.() ?? []) {
      if (!gamepad || !HOLD_BUTTONS.some((button) => gamepad.buttons[button]?.pressed)) continue;
      const [right, back] = gamepad.axes.map((value) => (Math.abs(value) < DEAD_ZONE ? 0 : value));
      return [limited(-back), limited(-right)];
    }
    return null;
  }

  // When nothing is held any more, one last order stops the robot at once.
  tick() {
    const direction = this.direction();
    this.show(direction);
    if (!direction && !this.drives) return;
    this.drives = direction !== null;
    const [forward, left] = direction ?? [0, 0];
    this.send(forward < 0 ? BACKWARDS * forward : forward, left);
  }

  show(direction) {
    const [forward, left] = direction ?? [0, 0];
    this.pad.classList.toggle("held", direction !== null);
    const knob = this.pad.firstElementChild;
    knob.style.setProperty("translate", `${-left * 150}% ${-forward * 150}%`);
  }

  listen() {
    const { pad } = this;
    const hold = (event) => {
      const box = pad.getBoundingClientRect();
      const forward = 1 - (2 * (event.clientY - box.top)) / box.height;
      const left = 1 - (2 * (event.clientX - box.left)) / box.width;
      this.held = [limited(forward), limited(left)];
    };
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      hold(event);
      this.tick();
    });
    pad.addEventListener("pointermove", (event) => this.held && hold(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) pad.addEventListener(end, () => this.release());
    document.addEventListener("keydown", (event) => {
      if (event.repeat || event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input, select")) return;
      if (this.takes(event.key)) this.keys.add(event.key.toLowerCase());
    });
    document.addEventListener("keyup", (event) => this.keys.delete(event.key.toLowerCase()));
    // A page that is not in front gets no "keyup".
    window.addEventListener("blur", () => this.release());
    document.addEventListener("visibilitychange", () => document.hidden && this.release());
  }
}
