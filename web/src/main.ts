/** The operator's page: the state of the machine, and the commands that are possible now. */

import "./style.css";
import { Curves } from "./curves";
import { by, made, put, tell, value } from "./dom";
import { Draw } from "./draw";
import { Guide } from "./guide";
import { Hands } from "./hands";
import type { FromPanel, Mandrel, State, Welcome } from "./messages";
import { Program } from "./program";
import { Rest } from "./rest";
import { Session, say, toldRun, unitOf } from "./session";
import { Teach } from "./teach";
import { Traces } from "./traces";
import { View3d } from "./view3d";

const STALE_S = 0.5;
const USUAL_S = 0.2;
const TELLS_MS = 250;
/** Commands for part programs, and commands that need a homed machine. */
const OF_PROGRAMS = new Set(["teach", "zero-here"]);
const HOME_FIRST = "home first: the positions of the axes are unknown";
const BY_PLACE = new Set(["jog", "step", "zero", "zero-axis"]);
let bare: Mandrel | null = null; // the bare machine, before anything is planned
let toldEnd = "", toldFault = ""; // the last message about the end of a run, and about a fault
let toldMs = -Infinity, toldUsual = false; // when the age of the data was last shown, and whether it was usual

const curves = new Curves(by("position"), by("deviation"));
const session = new Session(heard, () => show(null));
const hands = new Hands(session);
const program = new Program(session);
const teach = new Teach(session, program);
new Draw(session, program);
const traces = new Traces(session);
const rest = new Rest(session, program);
const guide = new Guide(session);
const view = shownIn3d();
const shown = (): string => by<HTMLSelectElement>("axis").value;

function heard(message: FromPanel): void {
  if (message.type === "welcome") {
    session.me = message.client;
    [session.axes, session.lacks, session.untaught, session.byHand, session.options] = [message.axes, message.lacks, message.untaught, message.by_hand, message.options];
    session.figuresAt = 0; // a new panel counts its states from 0, and sends its figures
    by("machine").textContent = `${message.machine}, ${message.simulated ? "simulated" : message.link}`;
    hands.build();
    teach.build();
    program.build();
    tellLink(message);
    offer(message.axes.map((axis) => axis.name));
    bare = message.mandrel;
    view?.show(session.figures, bare);
  } else if (message.type === "state") {
    offer(Object.keys(message.axes));
    if (session.machineMoves()) curves.add(message, shown(), unitOf(session, shown())[0]);
  } else if (message.type === "figures") {
    session.figures = message;
    session.figuresAt = session.state?.seq ?? 0;
    replan();
    program.tell(message);
    view?.show(message, message.mandrel);
  } else if (message.type === "answer") {
    const renewal = session.renewal(message.number);
    if (!message.ok && session.moves) session.letGo();
    if (!message.ok && !renewal) say(message.text, true);
  } else if (message.type === "said") say(message.text, message.wrong);
}

/** Show what the link leads to, and which commands it lacks. */
function tellLink(welcome: Welcome): void {
  const lacking = Object.entries(welcome.lacks).map(([what, why]) => `${what} is not available on this link: ${why}.`);
  by("link-notes").replaceChildren(...[welcome.label, ...lacking, ...welcome.notes].filter(Boolean).map((text) => made("li", text)));
}

/** Offer the axes and other moving bodies for the curves. */
function offer(names: string[]): void {
  const chosen = by<HTMLSelectElement>("axis"), there = new Set([...chosen.options].map((one) => one.value));
  const fresh = names.filter((name) => !there.has(name));
  if (fresh.length === 0) return;
  chosen.append(...fresh.map((name) => made("option", name)));
  if (there.size === 0) chosen.value = names.find((name) => unitOf(session, name)[1] === "mm") ?? chosen.value;
  replan();
}

function replan(): void { for (const one of document.querySelectorAll(".axis-unit")) one.textContent = `in ${unitOf(session, shown())[1]}`; curves.plan(session.figures, shown(), unitOf(session, shown())[0]); }

/** The view in three dimensions, if the browser can draw it. */
function shownIn3d(): View3d | null {
  try {
    return new View3d(by("space"), () => session.machineMoves());
  } catch {
    by("seen").textContent = "this browser has no WebGL: it cannot show the view in three dimensions";
    return null;
  }
}

/** Show one part of the page; STOP, state and control are always shown. */
function open(part: string): void {
  for (const tab of document.querySelectorAll<HTMLButtonElement>("nav button")) tab.setAttribute("aria-selected", String(tab.dataset.part === part));
  for (const one of document.querySelectorAll<HTMLElement>("main")) one.hidden = one.id !== part;
  by("said").textContent = "";
  by("said").hidden = part === "operate";
  if (part !== "operate" && part !== "teach-in") hands.disarm();
  if (part === "runs") void traces.list();
  if (part === "guide") void guide.open();
}

for (const tab of document.querySelectorAll<HTMLButtonElement>("nav button")) tab.onclick = () => open(tab.dataset.part!);
open("operate");

by("stop").onclick = () => session.link.stop();
by("take").onclick = () => { const held = session.state?.control; session.link.control(session.mine() ? (held?.asks != null ? "give" : "release") : "take"); };
by("token-enter").onclick = () => session.knock(value("token"));
by("token").onkeydown = (event) => { if (event.key === "Enter") session.knock(value("token")); };
by("keep").onclick = () => session.link.control("keep");
by("axis").onchange = () => replan();

/** Show the age of the data: a few times a second, since each new text draws the page again; at once when it becomes unusual or usual again. */
function tellAge(age: number, stale: boolean): void {
  const now = performance.now(), usual = age <= USUAL_S;
  if (usual && toldUsual && now - toldMs < TELLS_MS) return;
  [toldUsual, toldMs] = [usual, now];
  tell("age", stale ? `no data for ${age.toFixed(1)} s` : `data ${Math.round(age * 1000)} ms old`);
}

/** Add to the list of events how a run ended, and why the machine is in fault. */
function tellEnds(state: State): void {
  const run = state.progress, wrong = ["fault", "gone"].includes(state.state);
  const fault = wrong ? `${state.state}: ${state.why}` : "", end = run?.ended && run.verdict ? toldRun(run) : "";
  if (end !== toldEnd && end) say(end, !run!.verdict.startsWith("IN SPEC"));
  if (fault !== toldFault && fault) say(fault, true);
  [toldEnd, toldFault] = [end, fault];
}

function show(state: State | null): void {
  const silent = (performance.now() - session.link.heardMs) / 1000;
  const age = state ? state.age_s + silent : silent;
  const stale = state === null || age > STALE_S;
  document.body.classList.toggle("stale", stale);
  tellAge(age, stale);
  const knocks = state === null && session.link.refused !== "";
  put(by("token-row"), "hidden", !knocks);
  tell("state", state ? `${state.state}${state.why ? `: ${state.why}` : ""}` : knocks ? `refused by the panel: ${session.link.refused}` : "no connection");
  put(by("state"), "className", !state || ["fault", "gone"].includes(state.state) ? "wrong" : "");
  const unreasoned = state !== null && program.wantsReason(state), can = (what: string) => (OF_PROGRAMS.has(what) ? teach.can(state) : session.can(what) && (what !== "continue" || rest.whole(traces.chosen) === ""));
  const changed = state !== null && program.changed(state);
  const homeless = state !== null && session.mine() && ["disabled", "enabled"].includes(state.state);
  for (const one of document.querySelectorAll<HTMLButtonElement>("button[data-what]")) put(one, "disabled", !hands.keeps(one) && (stale || !can(one.dataset.what!) || (one.dataset.what === "start" && unreasoned) || (changed && ["start", "approach"].includes(one.dataset.what!))));
  for (const one of document.querySelectorAll<HTMLButtonElement>("button[data-what]")) put(one, "title", session.lacking(one.dataset.what!) || (OF_PROGRAMS.has(one.dataset.what!) && session.untaught) || (one.dataset.what === "continue" && rest.whole(traces.chosen)) || (BY_PLACE.has(one.dataset.what!) ? (session.byHand ? homeless && HOME_FIRST : "this machine cannot be moved by hand") : "") || (one.disabled && state !== null ? session.waits(one.dataset.what!) : "") || "");
  put(by<HTMLButtonElement>("take"), "disabled", state === null);
  if (!state) { hands.disarm(); return; }
  const held = state.control, mine = session.mine(), asked = mine && held.asks !== null;
  tell("control", mine ? (asked ? `${held.asks_name} asks for control; it passes in ${held.passes_in_s.toFixed(0)} s` : "you have control") : held.client === null ? "nobody has control" : `${held.name} (${held.client}) has control${held.asks === session.me ? `; it passes in ${held.passes_in_s.toFixed(0)} s` : ""}`);
  tell("take", mine ? (asked ? "Give control" : "Release control") : held.client === null ? "Take control" : "Ask for control");
  put(by("keep"), "hidden", !asked);
  tellEnds(state);
  hands.show(state);
  program.show(state);
  traces.show(state);
  rest.show(state, traces.chosen);
  view?.live(state);
  // A state sent before the figures does not know of them yet.
  if (!state.proven && session.figures && state.calculating === null && state.seq > session.figuresAt + 1) { session.figures = null; program.forget(); replan(); view?.show(null, bare); }
}

/** Everything is drawn by one clock, so that the browser draws all changes in one frame. */
const TICK_MS = 50, CURVE_TICKS = 2, VIEW_TICKS = view?.slow ? 4 : 2;
let ticks = 0;
setInterval(() => {
  show(session.state && performance.now() - session.link.heardMs < 3000 ? session.state : null);
  if (ticks % VIEW_TICKS === 0) view?.draw();
  if (ticks % CURVE_TICKS === 0) curves.draw(["running", "holding"].includes(session.state?.state ?? ""));
  ticks++;
}, TICK_MS);
