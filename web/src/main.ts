/** The operator's page: what the machine is, and the commands that are possible now. */

import "./style.css";
import { Curves } from "./curves";
import { Link } from "./link";
import type { Axis, Figures, FromPanel, State } from "./messages";

const RENEW_MS = 80;
const STALE_S = 0.5;
const MOST_LINES = 50;

function by<T extends HTMLElement>(id: string): T { return document.getElementById(id) as T; }
function made<K extends keyof HTMLElementTagNameMap>(name: K, text = ""): HTMLElementTagNameMap[K] { const found = document.createElement(name); found.textContent = text; return found; }

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const curves = new Curves(by("position"), by("deviation"));
let me = 0;
let axes: Axis[] = [];
let figures: Figures | null = null;
let figuresAt = 0; // number of the state before them
let moves = 0; // of the timer that renews a jog or a move; 0 where there is none

const link = new Link(`${navigator.platform || "browser"}`.slice(0, 40), token, heard, () => { letGo(); show(null); });

const unitOf = (axis: Axis): [number, string] => axis.unit === "m" ? [1000, "mm"] : [180 / Math.PI, "°"];
const shownAxis = (): Axis | undefined => axes.find((axis) => axis.name === by<HTMLSelectElement>("axis").value);
const mine = (): boolean => link.lease !== "" && link.state?.control.client === me;
const can = (what: string): boolean => mine() && (link.state?.allowed.includes(what) ?? false);

function say(text: string, wrong = false): void {
  const line = made("li", `${new Date().toLocaleTimeString()}  ${text}`);
  line.className = wrong ? "wrong" : "";
  by("log").prepend(line);
  while (by("log").childElementCount > MOST_LINES) by("log").lastElementChild!.remove();
}

function heard(message: FromPanel): void {
  if (message.type === "welcome") { me = message.client; axes = message.axes; by("machine").textContent = `${message.machine}, ${message.simulated ? "simulated" : message.link}`; build(); void list(); }
  else if (message.type === "state") { const axis = shownAxis(); if (axis) curves.add(message, axis.name, unitOf(axis)[0]); }
  else if (message.type === "figures") { figures = message; figuresAt = link.state?.seq ?? 0; replan(); tell(message); }
  else if (message.type === "answer") { if (!message.ok && moves === 0) say(message.text, true); else if (!message.ok) { letGo(); } }
  else if (message.type === "said") say(message.text, message.wrong);
}

/** A motion that goes on only while the page renews it; the first renewal that is refused says that it has ended. */
function hold(command: { what: string; [key: string]: unknown }): void {
  letGo();
  if (!can(command.what)) return;
  link.act(command);
  moves = window.setInterval(() => {
    if (document.hidden || !mine()) { letGo(); return; }
    link.act({ what: "renew" });
  }, RENEW_MS);
}

function letGo(): void {
  if (moves === 0) return;
  clearInterval(moves);
  moves = 0;
  link.act({ what: "let-go" });
}

function button(text: string, what: string, press: () => void): HTMLButtonElement {
  const found = made("button", text);
  found.dataset.what = what;
  found.onclick = press;
  return found;
}

function build(): void {
  const simple = (text: string, what: string) => button(text, what, () => link.act({ what }));
  by("commands").replaceChildren(simple("Enable", "enable"), simple("Disable", "disable"), simple("Home all", "home"), button("Zero all", "zero", () => hold({ what: "zero" })), simple("Reset", "reset"), simple("Reconnect", "reconnect"));
  by("run").replaceChildren(button("Approach", "approach", () => hold({ what: "approach" })), button("Start", "start", () => { const proof = link.state?.proven?.proof; if (proof) link.act({ what: "start", proof }); }), simple("Hold", "hold"), simple("Resume", "resume"));
  by("axes").replaceChildren(...axes.map((axis) => {
    const row = made("tr");
    const jog = (text: string, sign: number) => {
      const found = made("button", text);
      found.dataset.what = "jog";
      found.setAttribute("aria-label", `Jog ${axis.name} ${sign > 0 ? "plus" : "minus"} while held`);
      const begin = () => hold({ what: "jog", axis: axis.name, share: sign * Number(by<HTMLInputElement>("share").value) / 100 });
      found.onpointerdown = (event) => { found.setPointerCapture(event.pointerId); begin(); };
      found.onpointerup = found.onpointercancel = found.onlostpointercapture = () => letGo();
      found.oncontextmenu = (event) => event.preventDefault();
      return found;
    };
    const cell = (...inside: Node[]) => { const found = made("td"); found.append(...inside); return found; };
    const at = made("td"); at.id = `at-${axis.name}`; at.className = "number";
    row.append(made("th", axis.name), at, cell(jog("−", -1)), cell(jog("+", 1)), cell(button(`Home ${axis.name}`, "zero-axis", () => hold({ what: "zero-axis", axis: axis.name }))));
    return row;
  }));
  by("axis").replaceChildren(...axes.map((axis) => made("option", axis.name)));
  const first = axes.find((axis) => axis.unit === "m");
  if (first) by<HTMLSelectElement>("axis").value = first.name;
  replan();
}

function replan(): void {
  const axis = shownAxis();
  if (axis) curves.plan(figures, axis.name, unitOf(axis)[0]);
}

function tell(found: Figures): void {
  const worst = (name: string) => found.criteria.find((one) => one.name === name && one.measured !== null);
  const mm = (name: string) => { const one = worst(name); return one ? `${(one.measured! * 1000).toFixed(3)} mm${one.limit === null ? "" : ` of ${(one.limit * 1000).toFixed(3)} mm`}` : "not measured"; };
  const rows: [string, string][] = [["program", found.program], ["verdict", found.closing], ["duration", `${found.duration_s.toFixed(2)} s`], ["ticks", String(found.ticks ?? "none")], ["circuits", found.circuits === null ? "1" : `${found.circuits}, ${found.ticks_per_circuit} ticks each on average`], ["points", String(found.points)], ["path deviation", mm("path_deviation")], ["contour error", mm("contour_error")]];
  by("figures").replaceChildren(...rows.flatMap(([name, value]) => { const dd = made("dd", value); if (name === "verdict" && !found.passed) dd.className = "wrong"; return [made("dt", name), dd]; }));
  for (const warning of found.warnings) say(warning);
}

async function list(): Promise<void> {
  const answer = await fetch("/api/programs", { headers: { Authorization: `Bearer ${token}` } });
  if (!answer.ok) { say(await answer.text(), true); return; }
  const chosen = by<HTMLSelectElement>("program");
  const before = chosen.value;
  chosen.replaceChildren(...((await answer.json()) as string[]).map((name) => made("option", name)));
  if (before) chosen.value = before;
}

by("stop").onclick = () => link.stop();
window.addEventListener("keydown", (event) => {
  if (event.key === "Escape" || (event.key === " " && !(event.target instanceof HTMLInputElement && event.target.type !== "range"))) { event.preventDefault(); letGo(); link.stop(); }
}, true);
window.addEventListener("blur", letGo);
document.addEventListener("visibilitychange", () => { if (document.hidden) letGo(); });
by("take").onclick = () => { const held = link.state?.control; link.control(mine() ? (held?.asks != null ? "give" : "release") : "take"); };
by("keep").onclick = () => link.control("keep");
by("axis").onchange = () => { curves.clear(); replan(); };
by("share").oninput = () => { by("share-shown").textContent = `${by<HTMLInputElement>("share").value} %`; };
by("calculate").dataset.what = "calculate";
by("calculate").onclick = () => {
  const feed = by<HTMLInputElement>("feed").value.trim();
  link.act({ what: "calculate", program: by<HTMLSelectElement>("program").value, interpolation: by<HTMLSelectElement>("interpolation").value, feed: feed || null });
};
by("file").onchange = async () => {
  const input = by<HTMLInputElement>("file"), file = input.files?.[0];
  if (!file) return;
  const answer = await fetch(`/api/programs/${encodeURIComponent(file.name)}`, { method: "PUT", body: file, headers: { Authorization: `Bearer ${token}`, "X-Lease": link.lease } });
  say(answer.ok ? `${file.name} is in the project folder` : (await answer.text()).trim(), !answer.ok);
  input.value = "";
  await list();
  if (answer.ok) by<HTMLSelectElement>("program").value = file.name;
};

function show(state: State | null): void {
  const silent = (performance.now() - link.heardMs) / 1000;
  const age = state ? state.age_s + silent : silent;
  const stale = state === null || age > STALE_S;
  document.body.classList.toggle("stale", stale);
  by("age").textContent = stale ? `no data for ${age.toFixed(1)} s` : `data ${Math.round(age * 1000)} ms old`;
  const named = by("state");
  named.textContent = state ? `${state.state}${state.why ? `: ${state.why}` : ""}` : "no connection";
  named.className = !state || ["fault", "gone"].includes(state.state) ? "wrong" : "";
  for (const one of document.querySelectorAll<HTMLButtonElement>("button[data-what]")) one.disabled = stale || !can(one.dataset.what!);
  const take = by<HTMLButtonElement>("take");
  take.disabled = state === null;
  by<HTMLInputElement>("file").disabled = !mine();
  if (!state) return;
  const held = state.control, asked = mine() && held.asks !== null;
  by("control").textContent = mine() ? (asked ? `${held.asks_name} asks for control; it passes in ${held.passes_in_s.toFixed(0)} s` : "you have control") : held.client === null ? "nobody has control" : `${held.name} (${held.client}) has control${held.asks === me ? `; it passes in ${held.passes_in_s.toFixed(0)} s` : ""}`;
  take.textContent = mine() ? (asked ? "Give control" : "Release control") : held.client === null ? "Take control" : "Ask for control";
  by("keep").hidden = !asked;
  for (const axis of axes) {
    const at = state.axes[axis.name], [scale, unit] = unitOf(axis), value = at?.measured ?? at?.commanded;
    by(`at-${axis.name}`).textContent = value === null || value === undefined ? "–" : `${(value * scale).toFixed(2)} ${unit}`;
  }
  const run = state.progress;
  by<HTMLProgressElement>("progress").value = run ? Math.min(run.time_s / run.duration_s, 1) : 0;
  by("progress-text").textContent = state.calculating !== null ? `calculating, ${Math.round(state.calculating * 100)} %` : !run ? "" : run.ended ? `${run.program}: ${run.ended}${run.why ? `, ${run.why}` : ""}. ${run.verdict}` : `${run.program}: ${run.time_s.toFixed(1)} s, ${Math.max(run.duration_s - run.time_s, 0).toFixed(1)} s left`;
  by("progress-text").className = run?.ended && !run.verdict.startsWith("IN SPEC") && run.verdict ? "wrong" : "";
  // A state that was on its way when they came does not know of them yet.
  if (!state.proven && figures && state.calculating === null && state.seq > figuresAt + 1) { figures = null; by("figures").replaceChildren(); replan(); }
}

setInterval(() => show(link.state && performance.now() - link.heardMs < 3000 ? link.state : null), 50);
setInterval(() => curves.draw(["running", "holding"].includes(link.state?.state ?? "")), 100);
