// The hand: drags, wheel and keys become a place, which the tool follows smoothly and no faster than a person moves.

/** Time constant of the follower [s]: a pointer's 60 steps a second would be felt as vibration. */
const TIME_CONSTANT_S = 0.025;
const FASTEST_M_PER_S = 0.06;
/** Longest time [s] by which one tick moves the tool: after a pause it goes on from its last place. */
const LONGEST_STEP_S = 0.02;
const DEEPEST_M = 0.085;
const REACH_M = 0.05;
const WHEEL_M_PER_PX = 5e-5;
const KEY_STEP_M = 0.0005;
const PAGE_STEP_M = 0.005;
/** Axis and direction of keys: the first axis goes down, the second to the right, the third away. */
const KEYS: Readonly<Record<string, readonly [number, number]>> = {
  ArrowDown: [0, KEY_STEP_M],
  ArrowUp: [0, -KEY_STEP_M],
  PageDown: [0, PAGE_STEP_M],
  PageUp: [0, -PAGE_STEP_M],
  ArrowRight: [1, KEY_STEP_M],
  ArrowLeft: [1, -KEY_STEP_M],
  w: [2, KEY_STEP_M],
  s: [2, -KEY_STEP_M],
};

export class Hand {
  /** Where the tool is [m]. */
  readonly placeM: number[];
  readonly #wantedM: number[];
  readonly #speed: number[];
  #heldBy: number | undefined;
  #from: [number, number] = [0, 0];
  #lastUs: number | undefined;

  constructor(
    readonly surface: HTMLElement,
    readonly axes: number,
    readonly metresPerPixel: () => number,
  ) {
    [this.placeM, this.#wantedM, this.#speed] = [0, 1, 2].map(() => new Array<number>(axes).fill(0)) as [number[], number[], number[]];
    surface.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || this.#heldBy !== undefined) return;
      surface.setPointerCapture(event.pointerId);
      this.#heldBy = event.pointerId;
      this.#from = [event.clientX, event.clientY];
    });
    surface.addEventListener("pointermove", (event) => {
      if (event.pointerId !== this.#heldBy) return;
      const perPixel = this.metresPerPixel();
      this.#move(1, (event.clientX - this.#from[0]) * perPixel);
      this.#move(0, (event.clientY - this.#from[1]) * perPixel);
      this.#from = [event.clientX, event.clientY];
    });
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const)
      surface.addEventListener(kind, ({ pointerId }) => {
        if (pointerId === this.#heldBy) this.#heldBy = undefined;
      });
    surface.addEventListener(
      "wheel",
      (event) => {
        if (this.axes < 3) return;
        event.preventDefault();
        this.#move(2, -event.deltaY * WHEEL_M_PER_PX);
      },
      { passive: false },
    );
    surface.addEventListener("keydown", (event) => {
      const move = KEYS[event.key];
      if (event.key === "Escape" || event.key === "Home") this.letGo();
      else if (move !== undefined && move[0] < this.axes) this.#move(move[0], move[1] * (event.shiftKey ? 0.2 : 1));
      else return;
      event.preventDefault();
    });
    // Nobody sees a hidden page, and its pointer may be anywhere when it is seen again.
    document.addEventListener("visibilitychange", () => document.hidden && this.letGo());
    addEventListener("pagehide", () => this.letGo());
  }

  /** Withdraw the tool. */
  letGo(): void {
    this.#heldBy = undefined;
    this.#wantedM.fill(0);
  }

  /** Return where the tool is at a time [µs]: a critically damped follower, solved exactly, of bounded speed. */
  at(nowUs: number): number[] {
    const s = Math.min(LONGEST_STEP_S, Math.max(0, (nowUs - (this.#lastUs ?? nowUs)) / 1e6));
    this.#lastUs = nowUs;
    const decay = Math.exp(-s / TIME_CONSTANT_S);
    const before = [...this.placeM];
    for (let axis = 0; axis < this.axes; axis++) {
      const [wanted, speed] = [this.#wantedM[axis] ?? 0, this.#speed[axis] ?? 0];
      const off = (before[axis] ?? 0) - wanted;
      const slope = speed + off / TIME_CONSTANT_S;
      this.placeM[axis] = wanted + (off + slope * s) * decay;
      this.#speed[axis] = (speed - (slope * s) / TIME_CONSTANT_S) * decay;
    }
    const path = Math.hypot(...this.placeM.map((each, axis) => each - (before[axis] ?? 0)));
    const share = path > 0 ? Math.min(1, (FASTEST_M_PER_S * s) / path) : 1;
    if (share < 1)
      for (let axis = 0; axis < this.axes; axis++) {
        const from = before[axis] ?? 0;
        this.placeM[axis] = from + share * ((this.placeM[axis] ?? 0) - from);
        this.#speed[axis] = s > 0 ? ((this.placeM[axis] ?? 0) - from) / s : 0;
      }
    return [...this.placeM];
  }

  #move(axis: number, byM: number): void {
    if (axis >= this.axes) return;
    const [least, most] = axis === 0 ? [0, DEEPEST_M] : [-REACH_M, REACH_M];
    this.#wantedM[axis] = Math.min(most, Math.max(least, (this.#wantedM[axis] ?? 0) + byM));
  }
}
