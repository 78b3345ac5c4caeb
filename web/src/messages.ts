/** The messages of the panel, from its schema: python -m tools.panel_schema */

/** Answer to a command: done, or why not. */
export interface Answer {
  type: "answer";
  number: number;
  ok: boolean;
  text: string;
}
/** An axis of the machine, SI units. */
export interface Axis {
  name: string;
  unit: "m" | "rad";
  low: number | null;
  high: number | null;
  manual_feed: number;
}
/** The settings of a controller; sent each time that they are read. */
export interface Board {
  type: "board";
  firmware: string;
  settings: BoardSetting[];
}
/** A setting of a controller beside the machine file. */
export interface BoardSetting {
  number: number;
  name: string;
  unit: string;
  board: string;
  words: string;
  file: string;
  mark: "" | "same" | "lower" | "other" | "refused";
}
/** Lines to a controller and from it, as they pass. */
export interface Console {
  type: "console";
  lines: Exchange[];
  left_out: number;
  whole: boolean;
}
/** A criterion of the specification and its result, as ``prove --json`` has it. */
export interface Criterion {
  name: string;
  axis: string;
  step: string;
  measured: number | null;
  limit: number | null;
  unit: string;
  status: string;
  time_s: number | null;
  job_line: number | null;
  passes: number[];
  operation: number | null;
  position: number[] | null;
  run: number | null;
  of: string;
  required: boolean;
  note: string;
}
/** A cylinder, from 0 to its stroke, SI; the outputs that move it, and its contacts. */
export interface Cylinder {
  name: string;
  unit: "m" | "rad";
  stroke: number;
  forward: string[];
  back: string[];
  contacts: EndSwitch[];
}
/** A contact that closes where its cylinder is ``beyond`` a position, SI. */
export interface EndSwitch {
  name: string;
  at: number;
  beyond: "below" | "above";
}
/** A line to a controller, or from it. */
export interface Exchange {
  at_s: number;
  kind: "typed" | "sent" | "program" | "heard";
  text: string;
  words: string;
}
/** The result of a calculation, SI units. */
export interface Figures {
  type: "figures";
  program: string;
  proof: string;
  passed: boolean;
  closing: string;
  duration_s: number;
  feed: string | null;
  ticks: number | null;
  circuits: number | null;
  ticks_per_circuit: number | null;
  points: number;
  warnings: string[];
  doubts: string[];
  criteria: Criterion[];
  times_s: number[];
  planned: Record<string, number[]>;
  mandrel: Mandrel | null;
  lines: Lines;
  stitches: Stitches | null;
  steps: NamedStep[];
  lanes: Lane[];
  turn_rounds: TurnRounds | null;
  tension: Tension | null;
}
/** How full a controller is: blocks of its planner, characters of its receive buffer. */
export interface Fill {
  blocks: number;
  of_blocks: number;
  characters: number;
  of_characters: number;
}
/** Who controls the machine, and who asks for it. */
export interface Holder {
  client: number | null;
  name: string;
  left_s: number;
  asks: number | null;
  asks_name: string;
  passes_in_s: number;
}
/** An input or output over the time of the plan: its first state, and when it changes, s. */
export interface Lane {
  name: string;
  input: boolean;
  on: boolean;
  changes_s: number[];
}
/** The client is in control, with this lease. */
export interface Leased {
  type: "leased";
  lease: string;
}
/** Lines and circuits of the job, and the time at which each begins, s. */
export interface Lines {
  times_s: number[];
  line: number[];
  circuit: number[];
}
/** The contour error of a run so far, m, at its samples; the judge looks between them, too. */
export interface LiveContour {
  now_m: number;
  worst_m: number;
  worst_s: number;
  limit_m: number;
  at: "load" | "encoder";
}
/** The mandrel, m: it turns with ``axis``, and has ``radius`` at the places ``at``. */
export interface Mandrel {
  axis: string;
  along: string;
  at: number[];
  radius: number[];
}
/** A step of a move list. */
export interface NamedStep {
  name: string;
  line: number;
  begin_s: number;
}
/** A program before it is calculated, SI units; the answer to a request. */
export interface Preview {
  program: string;
  planned: Record<string, number[]>;
  line: number[];
  moves: number;
  whole: boolean;
  paced_by: string;
  stitches: Stitches | null;
  steps: NamedStep[];
  warnings: string[];
  mandrel: Mandrel | null;
  file: string;
  text: string[];
}
/** Progress of the present run, or the final progress of the last run. */
export interface Progress {
  run: string;
  program: string;
  file: string;
  time_s: number;
  duration_s: number;
  ended: string | null;
  why: string;
  verdict: string;
  completed: number;
  hold: "at once" | "at a rest" | "at the end";
  hold_at_s: number | null;
  contour: LiveContour | null;
}
/** The latest calculation. */
export interface Proven {
  program: string;
  proof: string;
  passed: boolean;
  closing: string;
}
/** A quantity besides the axes' own, such as the tension of the fibre; SI units. */
export interface Reading {
  value: number;
  unit: string;
}
/** The rest of an interrupted run, ready to start; a stop drops it. */
export interface RestOfRun {
  run: string;
  notes: string[];
}
/** An event, for people. */
export interface Said {
  type: "said";
  text: string;
  wrong: boolean;
}
/** All data that a client needs in order to act; sent 20 times a second, or 10 if unchanged. */
export interface State {
  type: "state";
  seq: number;
  state: string;
  why: string;
  allowed: string[];
  age_s: number;
  time_s: number;
  axes: Record<string, Where>;
  signals: Record<string, number>;
  readings: Record<string, Reading>;
  late_ticks: number;
  feed_percent: number;
  no_override: string;
  control: Holder;
  progress: Progress | null;
  rest: RestOfRun | null;
  proven: Proven | null;
  calculating: number | null;
  board: Fill | null;
  busy: string;
  clients: number;
}
/** Holes of a seam or a design in order, thinned if there are many; m and s. */
export interface Stitches {
  x: number[];
  y: number[];
  joined: boolean[];
  block: number[];
  threads: (string | null)[];
  number: number[];
  count: number;
  times_s: number[];
  use: number[];
  use_of: string;
}
/** The tension of the fibre in the simulated run, N, where the machine has a spool. */
export interface Tension {
  times_s: number[];
  mean: number[];
  least: number;
  most: number;
}
/** Instants of the plan, s, and places, m, at which the axis along the mandrel turns round. */
export interface TurnRounds {
  axis: string;
  times_s: number[];
  at: number[];
}
/** Answer to a hello: the client's number, and the machine. */
export interface Welcome {
  type: "welcome";
  protocol: number;
  client: number;
  machine: string;
  title: string;
  link: string;
  simulated: boolean;
  label: string;
  lacks: Record<string, string>;
  notes: string[];
  untaught: string;
  by_hand: boolean;
  feed_override: boolean;
  options: string[];
  normal_feed: boolean;
  axes: Axis[];
  cylinders: Cylinder[];
  inputs: string[];
  outputs: string[];
  mandrel: Mandrel | null;
  console: boolean;
  jog_lease_s: number;
  control_lease_s: number;
}
/** Positions of an axis now, SI units; None if unknown, as for an axis that is not homed. */
export interface Where {
  commanded: number | null;
  measured: number | null;
  load: number | null;
}
export type FromPanel = Answer | Board | Console | Figures | Leased | Said | State | Welcome;
