/** The verdict of a calculation: its figures, and its criteria in sentences, each with the used share of its limit. */

import { by, made, put, tell, value } from "./dom";
import type { Criterion, Figures } from "./messages";
import { clock, nearest, sentence, used, verdictWords } from "./wording";

const NOTHING =
  "Nothing is calculated yet. Calculate plans the program, simulates it and checks it against the specification.";
let refusal = { program: "", why: "" };

/** Show in the verdict's place why a program has none; "" for no reason. */
export function tellRefusal(program: string, why: string): void {
  refusal = { program, why };
  tellNone();
}

function tellNone(): void {
  const of = refusal.why !== "" && refusal.program === value("program");
  tell("verdict-none", of ? refusal.why : NOTHING);
  put(by("verdict-none"), "className", of ? "wrong" : "hint");
}

/** Show a calculation; null for none. A line of the program in it leads there. */
export function tellVerdict(found: Figures | null, toLine: (line: number) => void): void {
  put(by("verdict-none"), "hidden", found !== null);
  if (found) refusal = { program: "", why: "" };
  tellNone();
  by("figures").replaceChildren(...(found ? figureRows(found) : []));
  by("criteria").replaceChildren(...(found ? criterionRows(found, toLine) : []));
  by("notes").replaceChildren(...(found?.warnings ?? []).map((text) => made("li", text)));
  put(by("doubts"), "hidden", !found?.doubts.length);
  by("doubts-told").replaceChildren(...(found?.doubts ?? []).map((text) => made("li", text)));
}

function criterionRows(found: Figures, toLine: (line: number) => void): HTMLLIElement[] {
  const { shown, others } = nearest(found.criteria);
  const rows = shown.map((one) => row(one, hasLines(found) ? toLine : null));
  return others ? [...rows, made("li", others)] : rows;
}

/** Whether the program is text, whose lines are known: a design of stitches in the colours of threads is none. */
export function hasLines(found: Pick<Figures, "stitches">): boolean {
  return !found.stitches?.threads.length;
}

function figureRows(found: Figures): HTMLElement[] {
  const verdict = made("dd", verdictWords(found.closing));
  verdict.className = found.passed ? "verdict" : "verdict wrong";
  const rows: [string, string][] = [
    ["program", found.program],
    ["duration", `${clock(found.duration_s)} (${found.duration_s.toFixed(2)} s)`],
    ...(found.feed === null ? [] : [["feed", found.feed] as [string, string]]),
    ...counts(found),
    ...controller(found),
  ];
  const name = made("dt", "verdict");
  return [name, verdict, ...rows.flatMap(([name, text]) => [made("dt", name), made("dd", text)])];
}

/** What a program has: stitches, the steps of a cycle, or circuits and points. */
export function counts(
  found: Pick<Figures, "stitches" | "steps" | "circuits" | "points">,
): [string, string][] {
  if (found.stitches) return [["stitches", String(found.stitches.count)]];
  if (found.steps.length) return [["steps", String(found.steps.length)]];
  const circuits: [string, string][] = found.circuits === null ? [] : [["circuits", String(found.circuits)]];
  return [...circuits, ["points", String(found.points)]];
}

/** The ticks of the controller, for a machine whose commands have some. */
function controller(found: Figures): [string, string][] {
  if (found.ticks === null) return [];
  const each = found.circuits === null ? "" : `, ${found.ticks_per_circuit} in a circuit on average`;
  return [["controller", `${found.ticks} ticks${each}`]];
}

/**
 * A criterion in words, a gauge of its limit, and a button to the line of its worst place. A design has
 * records in place of lines, and no text to lead to.
 */
export function row(one: Criterion, toLine: ((line: number) => void) | null): HTMLLIElement {
  const found = made("li");
  const text = made("span", sentence(one));
  const wrong = one.status === "failed";
  if (wrong) text.className = "wrong";
  found.append(text);
  if (one.step) found.append(` in step ${one.step}`);
  if (one.job_line && !toLine) found.append(`, at record ${one.job_line} of the design`);
  else if (one.job_line && toLine) {
    const line = one.job_line;
    const there = made("button", `line ${line}`);
    there.type = "button";
    there.className = "link";
    there.setAttribute("aria-label", `${one.name.replaceAll("_", " ")}: show line ${line}`);
    there.onclick = () => toLine(line);
    found.append(" ", there);
  }
  found.append(gauge(used(one) ?? 0, wrong));
  return found;
}

/** A bar of the used share of a limit. */
function gauge(share: number, wrong: boolean): HTMLDivElement {
  const found = made("div");
  const bar = made("i");
  found.className = wrong ? "gauge wrong" : "gauge";
  found.title = `${Math.round(share * 100)} % of the limit`;
  bar.style.width = `${Math.min(share, 1) * 100}%`;
  found.append(bar);
  return found;
}
