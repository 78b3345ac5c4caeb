/** Teach-in: a part program from points to which the machine was moved by hand. */

import { button, by, made, put, typing, value } from "./dom";
import type { State } from "./messages";
import type { Program } from "./program";
import type { Session } from "./session";
import { unitOf } from "./session";
import { say } from "./toasts";

export class Teach {
  private points: Record<string, number>[] = []; // mm or degrees

  constructor(
    private readonly session: Session,
    private readonly program: Program,
  ) {
    const record = button("Record point (p)", "teach", () => this.record());
    const save = button("Save program", "teach", () => void this.save());
    by("teach-row").prepend(record);
    by("teach-row").append(save);
    window.addEventListener("keydown", (event) => {
      if (
        event.key === "p" &&
        !event.repeat &&
        !event.ctrlKey &&
        !event.metaKey &&
        !typing() &&
        this.can(session.state)
      )
        this.record();
    });
  }

  /** Show why nothing can be taught to this machine. */
  build(): void {
    put(by("untaught"), "hidden", this.session.untaught === "");
    put(
      by("untaught"),
      "textContent",
      this.session.untaught && `Teach-in is not possible: ${this.session.untaught}.`,
    );
  }

  private record(): void {
    const state = this.session.state;
    if (!state) return;
    const at: Record<string, number> = {};
    for (const { name } of this.session.axes) {
      const where = state.axes[name],
        place = where?.measured ?? where?.commanded;
      if (place === null || place === undefined) {
        say(`the position of ${name} is not known: home first`, true);
        return;
      }
      at[name] = Number((place * unitOf(this.session, name)[0]).toFixed(3));
    }
    this.points.push(at);
    this.list();
  }

  private list(): void {
    put(by("untaught-yet"), "hidden", this.points.length > 0);
    by("taught").replaceChildren(
      ...this.points.map((point, k) => {
        const row = made("tr"),
          cells = Object.entries(point).map(([name, place]) => {
            const cell = made("td"),
              field = made("input");
            field.value = String(place);
            field.size = 8;
            field.setAttribute("aria-label", `${name} of point ${k + 1}`);
            field.onchange = () => {
              const told = Number(field.value);
              if (Number.isFinite(told)) point[name] = told;
              else field.value = String(point[name]);
            };
            cell.append(`${name} `, field, ` ${unitOf(this.session, name)[1]}`);
            return cell;
          });
        const gone = made("button", "Remove");
        gone.setAttribute("aria-label", `Remove point ${k + 1}`);
        gone.onclick = () => {
          this.points.splice(k, 1);
          this.list();
        };
        const last = made("td");
        last.append(gone);
        row.append(made("th", String(k + 1)), ...cells, last);
        return row;
      }),
    );
  }

  /** Write a part program in absolute positions, and upload it to the project folder. */
  private async save(): Promise<void> {
    const feed = Number(value("teach-feed"));
    if (this.points.length === 0 || !(feed > 0)) {
      say("a program needs a point and a feed above 0", true);
      return;
    }
    const blocks = this.points.map(
      (point, k) =>
        `N ${10 * (k + 1)} ${Object.entries(point)
          .map(([name, place]) => `${name} ${place}`)
          .join(" ")};`,
    );
    const text = ["%", "O 1;", "G90;", `G01 F ${feed};`, ...blocks, "M30;", "%", ""].join("\n");
    if (await this.program.load(`${value("teach-name")}.prg`, new Blob([text])))
      say("calculate it before it can be started");
  }

  /** Whether a point can be recorded now, or a program saved. */
  can(state: State | null): boolean {
    return (
      this.session.mine() &&
      state?.state === "idle" &&
      this.session.axes.length > 0 &&
      this.session.untaught === ""
    );
  }
}
