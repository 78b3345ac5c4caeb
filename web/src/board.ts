/** A controller's board: its settings beside the machine file, how full it is, and its console. */

import { button, by, made, put, tell, value } from "./dom";
import type { BoardSetting, Board as BoardTold, Console, Exchange, Fill, State, Welcome } from "./messages";
import type { Session } from "./session";

const MOST_LINES = 400;
const MOST_TYPED = 50;
const NEAR_END_PX = 24;
/** What a mark means, and whether it is trouble. */
const MARKS: Record<BoardSetting["mark"], [string, boolean]> = {
  "": ["", false],
  same: ["same", false],
  lower: ["lower: the board moves slower than the file says", false],
  other: ["different", false],
  refused: ["different: nothing moves until one of them is corrected", true],
};
const WHO: Record<Exchange["kind"], string> = { typed: "you", sent: "panel", program: "run", heard: "board" };

/** Settings that differ from the machine file first, then those that it has, then the others. */
export function inOrder(settings: BoardSetting[]): BoardSetting[] {
  const weight = (one: BoardSetting) =>
    one.mark === "refused" ? 0 : ["lower", "other"].includes(one.mark) ? 1 : one.file ? 2 : 3;
  return [...settings].sort((a, b) => weight(a) - weight(b) || a.number - b.number);
}

/** A table of settings, summed up in a sentence. */
export function settingsInWords(settings: BoardSetting[]): string {
  const of = (mark: BoardSetting["mark"]) => settings.filter((one) => one.mark === mark).length;
  const counted = (count: number, words: string) => (count ? [`${count} ${words}`] : []);
  const parts = [
    ...counted(of("refused"), "must be corrected"),
    ...counted(of("lower"), "lower than the file, which is allowed"),
    ...counted(of("other"), "different"),
    ...counted(of("same"), "the same"),
  ];
  return parts.length ? `Compared with the machine file: ${parts.join(", ")}.` : "";
}

/** How full a buffer is: "planner 3 of 15 blocks". */
export function filled(fill: Fill): [string, number][] {
  return [
    [`planner: ${fill.blocks} of ${fill.of_blocks} blocks`, fill.blocks / Math.max(fill.of_blocks, 1)],
    [
      `receive buffer: ${fill.characters} of ${fill.of_characters} characters`,
      fill.characters / Math.max(fill.of_characters, 1),
    ],
  ];
}

/** Lines that were typed, the latest last; arrows go through them. */
export class Typed {
  private lines: string[] = [];
  private at = 0;

  add(line: string): void {
    if (this.lines[this.lines.length - 1] !== line) this.lines.push(line);
    this.lines = this.lines.slice(-MOST_TYPED);
    this.at = this.lines.length;
  }

  /** The line before or after the shown one; "" after the latest. */
  go(by: number): string {
    this.at = Math.min(Math.max(this.at + by, 0), this.lines.length);
    return this.lines[this.at] ?? "";
  }
}

export class Board {
  private readonly typed = new Typed();
  private readonly bars: [HTMLElement, HTMLElement][] = [];

  constructor(private readonly session: Session) {
    const send = button("Send", "console", () => this.send());
    by("console-row").append(send);
    const field = by<HTMLInputElement>("console-line");
    field.onkeydown = (event) => {
      if (event.key === "Enter") this.send();
      else if (event.key === "ArrowUp" || event.key === "ArrowDown")
        field.value = this.typed.go(event.key === "ArrowUp" ? -1 : 1);
      else return;
      event.preventDefault();
    };
    const program = by<HTMLInputElement>("console-program");
    program.onchange = () => {
      put(by("console"), "className", program.checked ? "" : "no-program");
      this.toEnd();
    };
    for (const _ of [0, 1]) {
      const row = made("div");
      const text = made("span");
      const gauge = made("div");
      const bar = made("i");
      gauge.className = "gauge";
      gauge.append(bar);
      row.append(text, gauge);
      by("board-fill").append(row);
      this.bars.push([text, bar]);
    }
  }

  build(welcome: Welcome): void {
    put(by("board"), "hidden", !welcome.console);
  }

  private send(): void {
    const line = value("console-line");
    if (line === "" || !this.session.can("console")) return;
    this.typed.add(line);
    this.session.link.act({ what: "console", line });
    by<HTMLInputElement>("console-line").value = "";
  }

  show(state: State): void {
    const may = this.session.can("console");
    put(by<HTMLInputElement>("console-line"), "disabled", !may);
    put(by("board-fill"), "hidden", state.board === null);
    if (!state.board) return;
    filled(state.board).forEach(([text, share], k) => {
      const [name, bar] = this.bars[k]!;
      put(name, "textContent", text);
      const width = `${Math.round(100 * Math.min(share, 1))}%`;
      if (bar.style.width !== width) bar.style.width = width;
    });
  }

  // --- settings -------------------------------------------------------------------------------

  take(board: BoardTold): void {
    tell(
      "board-told",
      `${board.firmware ? `Firmware ${board.firmware}` : "grbl"}. ${settingsInWords(board.settings)}`,
    );
    put(by("board-told"), "className", board.settings.some((one) => MARKS[one.mark][1]) ? "wrong" : "hint");
    const rows = inOrder(board.settings);
    const own = (one: BoardSetting) => one.file !== "" || one.mark !== "";
    by("board-settings").replaceChildren(this.head(), ...rows.filter(own).map((one) => this.row(one)));
    by("board-others").replaceChildren(
      this.head(),
      ...rows.filter((one) => !own(one)).map((one) => this.row(one)),
    );
  }

  private head(): HTMLTableRowElement {
    const row = made("tr");
    row.append(...["", "Setting", "Board", "Machine file"].map((name) => made(name ? "th" : "td", name)));
    return row;
  }

  private row(one: BoardSetting): HTMLTableRowElement {
    const row = made("tr");
    const [words, wrong] = MARKS[one.mark];
    const number = made("td", `$${one.number}`);
    const name = made("td", one.name);
    const mark = made("small", words);
    name.append(made("br"), mark);
    const unit = one.unit ? ` ${one.unit}` : "";
    row.append(
      number,
      name,
      made(
        "td",
        `${shortly(one.board)}${one.board === "not told" ? "" : unit}${one.words ? ` (${one.words})` : ""}`,
      ),
      made("td", one.file ? `${shortly(one.file)}${unit}` : ""),
    );
    row.className = wrong ? "wrong" : "";
    if (one.mark === "refused" && one.file) {
      const take = made("button", "type it");
      take.type = "button";
      take.className = "link";
      take.setAttribute("aria-label", `Put $${one.number}=${one.file} into the line of the console`);
      take.onclick = () => {
        by<HTMLInputElement>("console-line").value = `$${one.number}=${one.file}`;
        by("console-line").focus();
      };
      mark.append(" ", take);
    }
    return row;
  }

  // --- lines ----------------------------------------------------------------------------------

  hear(told: Console): void {
    const log = by("console");
    const atEnd = log.scrollHeight - log.scrollTop - log.clientHeight < NEAR_END_PX;
    if (told.whole) log.replaceChildren();
    if (told.left_out) log.append(this.line("program", "", `${told.left_out} lines of the run are left out`));
    log.append(...told.lines.map((one) => this.line(one.kind, one.text, one.words, one.at_s)));
    while (log.childElementCount > MOST_LINES) log.firstElementChild!.remove();
    if (atEnd) this.toEnd(); // a reader further up stays there
  }

  private line(kind: Exchange["kind"], text: string, words: string, at_s?: number): HTMLLIElement {
    const found = made("li");
    const time = at_s === undefined ? "" : new Date(1000 * at_s).toLocaleTimeString();
    found.className = /^(error|ALARM)/.test(text) ? `${kind} wrong` : kind;
    found.append(made("small", `${time} ${WHO[kind]}`), made("code", text));
    if (words) found.append(made("span", words));
    return found;
  }

  private toEnd(): void {
    const log = by("console");
    log.scrollTop = log.scrollHeight;
  }
}

/** A number without zeros at its end: "4800.000" is 4800. */
export function shortly(text: string): string {
  return /^-?\d+\.\d+$/.test(text) ? text.replace(/\.?0+$/, "") : text;
}
