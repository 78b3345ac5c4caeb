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
/** Lines and circuits of the job, and the times from which each is under way, s. */
export interface Lines {
  times_s: number[];
  line: number[];
  circuit: number[];
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
/** A run, or the last one. */
export interface Progress {
  run: string;
  program: string;
  time_s: number;
  duration_s: number;
  ended: string | null;
  why: string;
  verdict: string;
}
/** The latest calculation. */
export interface Proven {
  program: string;
  proof: string;
  passed: boolean;
  closing: string;
}
/** The rest of an interrupted run, ready to start; a stop drops it. */
export interface RestOfRun {
  run: string;
  told: string[];
}
/** An event, for people. */
export interface Said {
  type: "said";
  text: string;
  wrong: boolean;
}
/** All data that a client needs in order to act; sent 25 times a second. */
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
  late_ticks: number;
  feed_percent: number;
  no_override: string;
  control: Holder;
  progress: Progress | null;
  rest: RestOfRun | null;
  proven: Proven | null;
  calculating: number | null;
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
  mandrel: Mandrel | null;
  jog_lease_s: number;
  control_lease_s: number;
}
/** Positions of an axis now, SI units; None if unknown, as for an axis that is not homed. */
export interface Where {
  commanded: number | null;
  measured: number | null;
  load: number | null;
}
export type FromPanel = Answer | Figures | Leased | Said | State | Welcome;
