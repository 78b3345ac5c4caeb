/** Guide to the machine, also for print: axes, signals, connectors, calibration step by step. */

import { by, made } from "./dom";
import type { Session } from "./session";
import { say } from "./toasts";

interface Table {
  title: string;
  header: string[];
  rows: string[][];
  note: string;
}

export class Guide {
  private there = false;

  constructor(private readonly session: Session) {
    by("print-guide").onclick = () => window.print();
    by<HTMLButtonElement>("print-guide").disabled = true; // an empty sheet until the guide is loaded
    by("guide-pdf").onclick = () => void this.save();
  }

  async open(): Promise<void> {
    if (this.there) return;
    by("guide-said").textContent = "The guide is being made.";
    const answer = await this.session.ask("/api/guide");
    by("guide-said").textContent = "";
    if (!answer.ok) {
      say((await answer.text()).trim(), true);
      by("guide-said").textContent = "the guide could not be made: see Run, What happened";
      return;
    }
    const { machine, tables } = (await answer.json()) as { machine: string; tables: Table[] };
    by("guide-title").textContent = `Guide to ${machine}`;
    by("guide-tables").replaceChildren(...tables.flatMap((one) => this.table(one)));
    by<HTMLButtonElement>("print-guide").disabled = false;
    this.there = true;
  }

  private table({ title, header, rows, note }: Table): HTMLElement[] {
    const table = made("table"),
      head = made("tr");
    head.append(...header.map((name) => made(name ? "th" : "td", name)));
    table.append(
      head,
      ...rows.map((row) => {
        const line = made("tr");
        line.append(...row.map((text) => made("td", text)));
        return line;
      }),
    );
    const what = made("p", note);
    what.className = "hint";
    return [made("h3", title), ...(note ? [what] : []), table];
  }

  private async save(): Promise<void> {
    const answer = await this.session.ask("/api/guide.pdf");
    if (!answer.ok) {
      say((await answer.text()).trim(), true);
      return;
    }
    const to = made("a");
    to.href = URL.createObjectURL(await answer.blob());
    to.download = "guide.pdf";
    to.click();
    URL.revokeObjectURL(to.href);
  }
}
