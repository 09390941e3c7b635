// The picture: how deep the tool is and the force there, and the force of the last seconds.

const SHOWN_S = 6;
const ROWS = 1 << 13;
const DEEPEST_M = 0.085;
const STRONGEST_N = 4.6;

/** The newest ticks: time [µs], depth [m] and force [N] of each. */
export class Ticks {
  readonly #rows = new Float64Array(3 * ROWS);
  #count = 0;

  add(nowUs: number, depthM: number, forceN: number): void {
    this.#rows.set([nowUs, depthM, forceN], 3 * (this.#count++ % ROWS));
  }

  /** Return those of the last `seconds`, oldest first. */
  since(nowUs: number, seconds = Infinity): number[][] {
    const rows: number[][] = [];
    for (let at = Math.max(0, this.#count - ROWS); at < this.#count; at++) {
      const row = this.#rows.subarray(3 * (at % ROWS), 3 * (at % ROWS) + 3);
      if ((row[0] ?? 0) >= nowUs - 1e6 * seconds) rows.push([...row]);
    }
    return rows;
  }
}

const COLOURS = ["line", "muted", "ink", "held"] as const;

export class Picture {
  readonly #pen: CanvasRenderingContext2D;
  readonly #colours = new Map<string, string>();

  constructor(readonly canvas: HTMLCanvasElement) {
    const pen = canvas.getContext("2d");
    if (pen === null) throw new Error("this browser cannot draw");
    this.#pen = pen;
    const dark = matchMedia("(prefers-color-scheme: dark)");
    dark.addEventListener("change", () => this.#readColours());
    this.#readColours();
  }

  #readColours(): void {
    const { style } = this.canvas;
    for (const name of COLOURS) {
      style.color = `var(--${name})`;
      this.#colours.set(name, getComputedStyle(this.canvas).color);
    }
    style.color = "";
  }

  metresPerPixel(): number {
    return DEEPEST_M / Math.max(1, this.canvas.clientHeight - 2 * 16);
  }

  draw(nowUs: number, ticks: Ticks, placeM: readonly number[], forceN: readonly number[]): void {
    const { canvas } = this;
    const pen = this.#pen;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const ratio = devicePixelRatio;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const colour = (name: (typeof COLOURS)[number]) => this.#colours.get(name) ?? "";
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const y = (m: number) => 16 + m / this.metresPerPixel();
    pen.font = "12px system-ui";
    for (let mm = 0; mm <= 80; mm += 20) {
      pen.fillStyle = colour("line");
      pen.fillRect(0, y(mm / 1000), width, 1);
      pen.fillStyle = colour("muted");
      pen.fillText(`${mm} mm`, 8, y(mm / 1000) - 4);
    }
    pen.strokeStyle = colour("held");
    pen.lineWidth = 2;
    pen.beginPath();
    const right = width - 74;
    for (const [t = 0, , force = 0] of ticks.since(nowUs, SHOWN_S)) {
      const x = right - ((nowUs - t) / 1e6 / SHOWN_S) * (right - 56);
      pen.lineTo(x, height - 10 - (Math.min(STRONGEST_N, Math.abs(force)) / STRONGEST_N) * (height * 0.4));
    }
    pen.stroke();
    const [x, tip] = [width - 44 + ((placeM[1] ?? 0) / 0.05) * 24, y(placeM[0] ?? 0)];
    pen.fillStyle = colour("ink");
    pen.fillRect(x - 2, 0, 4, tip);
    const push = (Math.min(STRONGEST_N, Math.hypot(...forceN)) / STRONGEST_N) * 90;
    pen.fillStyle = colour("held");
    pen.fillRect(x - 8, tip - push, 16, push);
    pen.beginPath();
    pen.arc(x, tip, 7, 0, 7);
    pen.fill();
  }
}
