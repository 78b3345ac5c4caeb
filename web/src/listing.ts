/** The text of the program, with the line under way or the line of a worst place marked. */

import { by, made, put } from "./dom";

const AROUND = 150; // lines before and after the marked one

export class Listing {
  private text: string[] = [];
  private from = 0; // index of the first shown line
  private to = 0;
  private here = -1;

  /** Take the text of a program; empty for a binary one, which is not shown. */
  take(text: string[], file: string): void {
    this.text = text;
    [this.from, this.to, this.here] = [0, 0, -1];
    by("lines").replaceChildren();
    put(by("listing"), "hidden", text.length === 0);
    by("listing-title").textContent = `Text of ${file}`;
    if (text.length) this.lay(0);
  }

  /** Mark a line, from 1; it is scrolled into the middle of its list. */
  mark(line: number): void {
    const at = line - 1;
    if (at === this.here || at < 0 || at >= this.text.length) return;
    if (at < this.from || at >= this.to) this.lay(at);
    const lines = by("lines");
    lines.querySelector(".here")?.classList.remove("here");
    const found = lines.children[at - this.from] as HTMLElement | undefined;
    this.here = at;
    if (!found) return;
    found.classList.add("here");
    lines.scrollTop = found.offsetTop - lines.offsetTop - lines.clientHeight / 2;
  }

  private lay(about: number): void {
    this.from = Math.max(about - AROUND, 0);
    this.to = Math.min(about + AROUND, this.text.length);
    this.here = -1;
    by("lines").replaceChildren(
      ...this.text.slice(this.from, this.to).map((text, k) => {
        const found = made("li");
        found.append(made("span", String(this.from + k + 1)), text);
        return found;
      }),
    );
  }
}
