/** The operator's page: the state of the machine, and the commands that are possible now. */

import "./style.css";
import { Bar } from "./bar";
import { Board } from "./board";
import { Buttons } from "./buttons";
import { Continuing, RestHere } from "./continuing";
import { Curves } from "./curves";
import { by, made, put, tell, value } from "./dom";
import { Draw } from "./draw";
import { tellFacts } from "./facts";
import { Guide } from "./guide";
import { Jogging } from "./jogging";
import { Listing } from "./listing";
import { LiveError } from "./live_error";
import { Margins } from "./margins";
import type { FromPanel, Mandrel, State, Welcome } from "./messages";
import { nextStep, type Step } from "./next_step";
import { OwnButtons } from "./own_buttons";
import { Positions } from "./positions";
import { Program } from "./program";
import { measuresNothing, Session, toldRun, unitOf } from "./session";
import { Teach } from "./teach";
import { filterLog, note, say } from "./toasts";
import { Traces } from "./traces";
import { View } from "./view";
import { inTrouble } from "./wording";

const STALE_S = 0.5;
const USUAL_S = 0.2;
const TELLS_MS = 1000;
const AGE_STEP_MS = 50;
const UNDER_WAY = new Set(["running", "holding", "stopping"]);
const AT_START = 2e-4; // m or rad within which an axis stands where the program begins
/** Parts that share the page of the program and the machine. */
const WORK = ["prepare", "run"];

let bare: Mandrel | null = null; // the bare machine, before anything is planned
let next: Step | null = null; // the next step of the operator
let toldEnd = ""; // the last message about the end of a run
let toldFault = ""; // and about a fault
let toldMs = Number.NEGATIVE_INFINITY; // when the age of the data was last shown
let toldUsual = false; // and whether it was usual

const curves = new Curves(by("position"), by("deviation"));
const session = new Session(heard, () => show(null));
const positions = new Positions(session);
const jogging = new Jogging(session, positions);
const listing = new Listing();
const toLine = (line: number): void => {
  listing.mark(line);
  by("listing").scrollIntoView({ block: "nearest" });
};
const margins = new Margins(toLine);
const liveError = new LiveError(toLine);
const board = new Board(session);
const view = new View(
  by("space"),
  () => session.machineMoves(),
  (path) => session.ask(path),
);
const program = new Program(session, previewed, toLine);
const teach = new Teach(session, program);
new Draw(session, program);
const traces = new Traces(session);
const continuing = new Continuing(session, program, () => traces.chosen);
const restHere = new RestHere(session, program);
const guide = new Guide(session);
const bar = new Bar(session);
const own = new OwnButtons(session, program);
const buttons = new Buttons(session, jogging, program, teach, traces, continuing);
const shown = (): string => by<HTMLSelectElement>("axis").value;
filterLog();

function heard(message: FromPanel): void {
  if (message.type === "welcome") welcomed(message);
  else if (message.type === "state") {
    offer(Object.keys(message.axes));
    if (session.machineMoves()) curves.add(message, shown(), unitOf(session, shown())[0]);
    if (performance.now() - tickedMs > 0.5 * TICK_MS) tick();
  } else if (message.type === "figures") {
    session.figures = message;
    session.figuresAt = session.state?.seq ?? 0;
    replan();
    program.tell(message);
    picture();
  } else if (message.type === "answer") {
    const renewal = session.renewal(message.number);
    own.answered(message.number, message.ok);
    if (!message.ok && session.moves) session.letGo();
    if (!message.ok && !renewal) say(message.text, true);
  } else if (message.type === "said") {
    say(message.text, message.wrong);
    if (message.wrong && (session.state?.calculating ?? null) !== null) program.refused(message.text);
  } else if (message.type === "board") board.take(message);
  else if (message.type === "console") board.hear(message);
}

function welcomed(message: Welcome): void {
  session.welcome(message);
  const far = made("small", message.simulated ? "simulated" : message.link);
  by("machine").title = `${message.machine}, ${message.simulated ? "simulated" : message.link}`;
  const comma = made("span", ", "); // for screen readers: the next words stand on a line of their own
  comma.className = "unseen";
  by("machine").replaceChildren(message.machine, comma, far);
  jogging.build();
  teach.build();
  program.build();
  board.build(message);
  own.build(message.machine, message.console);
  view.of(message);
  offerParts(message);
  tellLink(message);
  offer(message.axes.map((axis) => axis.name));
  put(by("curves"), "hidden", message.axes.length === 0 && !message.by_hand);
  bare = message.mandrel;
  picture();
}

/** Show the parts of the page that the machine can use: teach-in and drawing may be missing. */
function offerParts(welcome: Welcome): void {
  put(by("tab-teach-in"), "hidden", welcome.untaught !== "");
  put(by("tab-drawing"), "hidden", !welcome.by_hand);
  const { part } = document.body.dataset;
  if (by(`tab-${part}`).hidden) open("run");
}

/** Show the far end of the link, and the commands that it lacks. */
function tellLink(welcome: Welcome): void {
  const lacking = Object.entries(welcome.lacks).map(
    ([what, why]) => `${what} is not available on this link: ${why}`,
  );
  const notes = [welcome.label, ...lacking, ...welcome.notes].filter(Boolean);
  by("link-notes").replaceChildren(...notes.map((text) => made("li", asSentence(text))));
  put(by("link-notes"), "hidden", notes.length === 0);
}

/** A note as a sentence: "disable is greyed" becomes "Disable is greyed." A name such as grbl keeps its letters. */
function asSentence(text: string): string {
  const first = text.startsWith("grbl") ? text : text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(first) ? first : `${first}.`;
}

/** Offer the axes and other moving bodies for the curves. */
function offer(names: string[]): void {
  const chosen = by<HTMLSelectElement>("axis");
  const there = new Set([...chosen.options].map((one) => one.value));
  const fresh = names.filter((name) => !there.has(name));
  if (fresh.length === 0) return;
  chosen.append(...fresh.map((name) => made("option", name)));
  if (there.size === 0)
    chosen.value = names.find((name) => unitOf(session, name)[1] === "mm") ?? chosen.value;
  replan();
}

function replan(): void {
  for (const one of document.querySelectorAll(".axis-unit"))
    one.textContent = `in ${unitOf(session, shown())[1]}`;
  curves.plan(session.figures, shown(), unitOf(session, shown())[0]);
}

/** A program was chosen: show its path and its text. */
function previewed(): void {
  listing.take(program.preview?.text ?? [], program.preview?.file ?? "");
  picture();
}

/** Draw what was calculated if it is the chosen program, else the chosen program, else the machine. */
function picture(): void {
  const { figures } = session;
  const other = program.preview !== null && figures !== null && program.preview.program !== figures.program;
  view.show(other ? null : figures, program.preview, bare);
  margins.show(figures);
  liveError.show(figures);
}

/** Show one part of the page; STOP, state and control are always shown. */
function open(part: string): void {
  document.body.dataset.part = part;
  for (const tab of document.querySelectorAll<HTMLButtonElement>("nav button"))
    tab.setAttribute("aria-selected", String(tab.dataset.part === part));
  const main = WORK.includes(part) ? "work" : part;
  for (const one of document.querySelectorAll<HTMLElement>("main")) one.hidden = one.id !== main;
  if (part !== "run" && part !== "teach-in") jogging.disarm();
  const hand = by(part === "teach-in" ? "teach-by-hand" : "by-hand-here"); // points are taught by moving
  if (by("hand").parentElement !== hand) hand.append(by("hand"));
  if (part === "prepare") void program.lookOnce();
  if (part === "review") void traces.list();
  if (part === "guide") void guide.open();
}

/** Scroll to the button of a step and give it the focus, without pressing it. */
function goTo(step: Step | null): void {
  if (!step) return;
  if (step.part) open(step.part);
  const fields: Record<string, string> = { load: "#program", reason: "#override" };
  const found = document.querySelector<HTMLElement>(
    fields[step.what] ?? "main button.next, header #run button.next, #take.next",
  );
  found?.scrollIntoView({ block: "center" });
  found?.focus({ preventScroll: true });
}

for (const tab of document.querySelectorAll<HTMLButtonElement>("nav button"))
  tab.onclick = () => open(tab.dataset.part!);
open("run");
by("next").onclick = () => goTo(next);
by("to-review").onclick = () => open("review");

by("stop").onclick = () => session.link.stop();
by("take").onclick = () => {
  const held = session.state?.control;
  giveBack(held?.asks != null ? "give" : "release");
};
by("release").onclick = () => giveBack("release");

/** Take control, or give it to whoever asks for it, or release it. */
function giveBack(word: "give" | "release"): void {
  released = session.mine();
  session.link.control(session.mine() ? word : "take");
}
by("token-enter").onclick = () => session.knock(value("token"));
by("token").onkeydown = (event) => {
  if (event.key === "Enter") session.knock(value("token"));
};
by("keep").onclick = () => session.link.control("keep");
by("axis").onchange = () => replan();
by("now-line").onclick = () => toLine(lineNow);

/**
 * Show the age of the data, rounded up: once a second, since each new text draws the page again; at once
 * when it becomes unusual or usual again.
 */
function tellAge(age: number, stale: boolean): void {
  const now = performance.now();
  const usual = age <= USUAL_S;
  if (usual && toldUsual && now - toldMs < TELLS_MS) return;
  [toldUsual, toldMs] = [usual, now];
  tell(
    "age",
    stale
      ? `no data for ${age.toFixed(1)} s`
      : `data ${AGE_STEP_MS * Math.max(Math.ceil((age * 1000) / AGE_STEP_MS), 1)} ms old`,
  );
}

/** Add to the list of events how a run ended, and why the machine is in fault. */
function tellEnds(state: State): void {
  const run = state.progress;
  const wrong = ["fault", "gone"].includes(state.state);
  const fault = wrong ? `${state.state}: ${state.why}` : "";
  const end = run?.ended && run.verdict ? toldRun(state) : "";
  // In Run the bar and the list of events show it, so that no message covers the machine.
  const tellEnd = document.body.dataset.part === "run" ? note : say;
  if (end !== toldEnd && end) tellEnd(end, inTrouble(run!));
  if (fault !== toldFault && fault) say(fault, true);
  [toldEnd, toldFault] = [end, fault];
}

let hadControl = 0; // number of this page when it had control; 0 for none in the last state
let askedForControl = false; // by this page, and not answered yet
let released = false; // by this page

/** Report a change of control that this page has not made itself. */
function tellPassed(state: State): void {
  const held = state.control;
  const mine = session.mine();
  const asks = held.asks === session.me;
  if (askedForControl && !asks && held.client !== null)
    say(mine ? "you have control now" : `${held.name} (${held.client}) keeps control`);
  else if (hadControl && !mine && !released)
    say(
      held.client === null || held.client === hadControl // which was this page, before it connected again
        ? "control was lost: take it again"
        : `control has passed to ${held.name} (${held.client})`,
      true,
    );
  [hadControl, askedForControl] = [mine ? session.me : 0, asks];
  if (!mine) released = false;
}

/** Show who has control, and who asks for it. */
function tellControl(state: State): void {
  const held = state.control;
  const mine = session.mine();
  const asked = mine && held.asks !== null;
  const passes = `it passes in ${held.passes_in_s.toFixed(0)} s`;
  const others = `${held.name} (${held.client}) has control${held.asks === session.me ? `; ${passes}` : ""}`;
  const own = asked ? `${held.asks_name} asks for control; ${passes}` : "you have control";
  tell("control", mine ? own : held.client === null ? "nobody has control" : others);
  const free = held.client === null ? "Take control" : "Ask for control";
  tell("take", mine ? (asked ? "Give control" : "Release control") : free);
  put(by("keep"), "hidden", !asked);
  put(document.body.dataset, "control", mine ? (asked ? "asked" : "mine") : "other");
}

/** Hide the difference of the measured position on a link that measures none. */
function tellMeasured(state: State): void {
  put(by("measured-minus"), "hidden", measuresNothing(state));
}

let lineNow = 0; // the line under way

/** Show the run, its line, and the next step. */
function tellWork(state: State): void {
  lineNow = bar.tellRun(state, session.figures);
  if (lineNow) listing.mark(lineNow);
  tellFacts(state, session.figures);
  document.body.toggleAttribute("data-runs", UNDER_WAY.has(state.state));
  const planned = session.figures?.planned ?? {};
  const atStart = Object.entries(planned).every(([name, at]) => {
    const stands = state.axes[name]?.commanded;
    return stands === null || stands === undefined || Math.abs(stands - (at[0] ?? stands)) < AT_START;
  });
  const step = nextStep(state, {
    mine: session.mine(),
    chosen: value("program") !== "",
    changed: program.changed(state),
    wantsReason: program.wantsReason(state),
    atStart,
  });
  bar.tellNext(step);
  next = step;
  restHere.show(state, !!session.figures?.stitches, atStart);
}

/** Show what changes all the time while the machine moves. */
function showNumbers(state: State): void {
  positions.show(state, bar.toGo(state, session.figures));
  liveError.live(state);
  view.live(state);
}

function show(state: State | null): void {
  const silent = (performance.now() - session.link.heardMs) / 1000;
  const age = state ? state.age_s + silent : silent;
  const stale = state === null || age > STALE_S;
  document.body.classList.toggle("stale", stale);
  if (state?.state === "connecting") tell("age", "");
  else tellAge(age, stale);
  const knocks = state === null && session.link.refused !== "";
  put(by("token-row"), "hidden", !knocks);
  bar.tellState(state, knocks ? session.link.refused : "");
  buttons.show(state, stale, state === null || silent > STALE_S);
  put(by<HTMLButtonElement>("take"), "disabled", state === null);
  if (!state) {
    jogging.disarm();
    bar.tellNext(null);
    next = null;
    return;
  }
  tellPassed(state);
  tellControl(state);
  tellEnds(state);
  tellWork(state);
  tellMeasured(state);
  showNumbers(state);
  jogging.show();
  program.show(state);
  margins.live(state);
  board.show(state);
  own.show(state);
  traces.show(state);
  continuing.show(state, traces.chosen);
  // A state sent before the figures does not know of them yet.
  const late = state.seq > session.figuresAt + 1;
  if (!state.proven && session.figures && state.calculating === null && late) {
    session.figures = null;
    program.forget();
    replan();
    picture();
  }
}

/**
 * One clock draws everything, so that the browser draws all changes in one frame; arriving states drive it.
 * Numbers follow each state. Everything else is checked four times a second, or at once if the state or the
 * operator changes something. If nothing has changed, nothing is drawn.
 */
const TICK_MS = 50;
const CURVE_TICKS = 4;
const REST_MS = 240; // time between two full checks if only numbers change
const ALONE_MS = 100; // period of the clock if no state comes
let ticks = 0;
let [tickedMs, allMs, drawnMs] = [0, 0, 0]; // when the page was last shown, all of it, and the view drawn
let shownState: State | null = null; // the state that the page shows
let shownWords = ""; // its content without the numbers
let touched = true; // the operator has done something since
for (const kind of ["input", "change", "click", "keydown", "keyup", "pointerdown", "pointerup", "focusin"])
  window.addEventListener(
    kind,
    () => {
      touched = true;
    },
    true,
  );

/** Show the latest state; the clock advances with each state, and by itself if none comes. */
function tick(): void {
  ticks++;
  tickedMs = performance.now();
  const silentMs = tickedMs - session.link.heardMs;
  const heard = session.link.hears && silentMs < 3000 ? session.state : null;
  const late = silentMs > STALE_S * 1000;
  const words = heard ? wordsOf(heard) : "";
  const all = touched || late || heard === null || words !== shownWords || tickedMs - allMs > REST_MS;
  if (all) {
    allMs = tickedMs;
    show(heard);
  } else if (session.link.changedState !== shownState) showNumbers(heard);
  [shownState, shownWords, touched] = [session.link.changedState, words, false];
  if (tickedMs - drawnMs > TICK_MS * (view.ticks - 0.5)) {
    drawnMs = tickedMs;
    view.draw();
  }
  if (ticks % CURVE_TICKS === 0) {
    liveError.draw();
    curves.draw(["running", "holding"].includes(session.state?.state ?? ""));
  }
}
setInterval(() => {
  if (performance.now() - tickedMs > 0.8 * ALONE_MS || touched) tick();
}, ALONE_MS);

/** The part of a state that the page need not follow at each tick, for comparison. */
function wordsOf(state: State): string {
  const { state: name, why, allowed, control, progress, rest, proven, busy, calculating } = state;
  const { client, asks } = control;
  const ended = progress && [progress.run, progress.ended, progress.verdict, progress.hold];
  return JSON.stringify([name, why, allowed, client, asks, ended, rest, proven, busy, calculating === null]);
}
