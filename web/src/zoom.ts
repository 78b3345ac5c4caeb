/** A part of a flat picture, seen larger: by buttons, by pinching, and moved by dragging. */

const MOST = 40;

export class Zoom {
  /** How much larger than the whole work it is seen. */
  factor = 1;
  private x = 0; // of the picture's middle from the work's, as a share of the picture at factor 1
  private y = 0;
  private readonly at = new Map<number, [number, number]>(); // pointers that are down, in pixels

  /** @param changed called when the picture is to be drawn again */
  constructor(
    private readonly place: HTMLElement,
    private readonly changed: () => void,
  ) {
    place.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey) return; // two fingers of a trackpad, or Ctrl; else the page scrolls
        event.preventDefault();
        this.by(Math.exp(-event.deltaY / 200));
      },
      { passive: false },
    );
    place.addEventListener("pointerdown", (event) => {
      this.at.set(event.pointerId, [event.clientX, event.clientY]);
      if (this.factor > 1) place.setPointerCapture(event.pointerId);
    });
    place.addEventListener("pointermove", (event) => this.moved(event));
    for (const end of ["pointerup", "pointercancel", "pointerleave"] as const)
      place.addEventListener(end, (event) => this.at.delete(event.pointerId));
    this.by(1);
  }

  /** See it larger by a factor; all of it with a factor of 0. */
  by(factor: number): void {
    this.factor = factor === 0 ? 1 : Math.min(Math.max(this.factor * factor, 1), MOST);
    // A work that is seen whole lets a finger scroll the page, and two fingers enlarge it.
    this.place.style.touchAction = this.factor > 1 ? "none" : "pan-y";
    this.place.style.cursor = this.factor > 1 ? "grab" : "";
    this.moveBy(0, 0);
  }

  private moved(event: PointerEvent): void {
    const before = this.at.get(event.pointerId);
    if (!before) return;
    const now: [number, number] = [event.clientX, event.clientY];
    const other = [...this.at].find(([id]) => id !== event.pointerId)?.[1];
    this.at.set(event.pointerId, now);
    if (other) this.by(apart(now, other) / Math.max(apart(before, other), 1));
    else if (this.factor > 1)
      this.moveBy(
        (before[0] - now[0]) / this.place.clientWidth,
        (before[1] - now[1]) / this.place.clientHeight,
      );
  }

  /** Move the part that is seen, in shares of the picture; no farther than the work goes. */
  moveBy(dx: number, dy: number): void {
    const most = (1 - 1 / this.factor) / 2;
    const within = (one: number) => Math.min(Math.max(one, -most), most);
    [this.x, this.y] = [within(this.x + dx / this.factor), within(this.y + dy / this.factor)];
    this.changed();
  }

  /** Where a place of the whole picture is seen, in the picture's own pixels. */
  seen(at: number, size: number, way: "x" | "y"): number {
    return size / 2 + (at - size / 2 - this[way] * size) * this.factor;
  }
}

function apart(one: [number, number], other: [number, number]): number {
  return Math.hypot(one[0] - other[0], one[1] - other[1]);
}
