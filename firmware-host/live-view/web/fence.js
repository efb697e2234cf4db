// Drawing an area that the robot keeps out of: two to four taps on the map, and a question before it is closed.

const CORNERS = 4;

export class Fence {
  // `form` has a paragraph and the buttons close, undo and cancel; `close(corners)` gets four corners.
  constructor(form, map, close) {
    Object.assign(this, { form, map, close, corners: null });
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      if (this.corners?.length >= 2) this.close(quadrilateral(this.corners));
      this.end();
    });
    form.querySelector("[data-do=undo]").addEventListener("click", () => {
      this.corners?.pop();
      this.show();
    });
    form.querySelector("[data-do=cancel]").addEventListener("click", () => this.end());
  }

  get draws() {
    return this.corners !== null;
  }

  begin() {
    this.corners = [];
    this.show();
  }

  end() {
    this.corners = null;
    this.show();
  }

  // Takes a tap on the map.
  tap(place) {
    if (this.corners.length < CORNERS) this.corners.push(place);
    this.show();
  }

  show() {
    const count = this.corners?.length ?? 0;
    this.form.hidden = !this.draws;
    const texts = ["Tap the first corner.", "Tap the next corner.", "A line. Tap further corners for an area.", "An area with three corners.", "An area with four corners."];
    this.form.querySelector("p").textContent = texts[count];
    this.form.querySelector("[type=submit]").disabled = count < 2;
    this.form.querySelector("[data-do=undo]").disabled = count === 0;
    this.map.set({ draft: this.corners ?? [] });
    this.form.dispatchEvent(new Event("draws"));
  }
}

// Four corners in an order in which the sides do not cross. A line goes forth and back.
function quadrilateral(corners) {
  const [a, b, c] = corners;
  if (corners.length === 2) return [a, b, b, a];
  if (corners.length === 3) return [a, b, c, c];
  const middle = { x: corners.reduce((sum, at) => sum + at.x, 0) / CORNERS, y: corners.reduce((sum, at) => sum + at.y, 0) / CORNERS };
  const angle = (at) => Math.atan2(at.y - middle.y, at.x - middle.x);
  return [...corners].sort((one, other) => angle(one) - angle(other));
}
