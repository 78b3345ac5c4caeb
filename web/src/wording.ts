/** Numbers and criteria of a verdict in the words of an operator. */

import type { Criterion } from "./messages";

/** Factors and units for people; a number without unit is a share. */
const UNITS: Record<string, [number, string]> = {
  m: [1000, "mm"],
  "m/s": [1000, "mm/s"],
  "m/s^2": [1, "m/s²"],
  rad: [180 / Math.PI, "°"],
  "rad/s": [180 / Math.PI, "°/s"],
  "rad/s^2": [180 / Math.PI, "°/s²"],
  s: [1000, "ms"],
  "m/s^3": [1, "m/s³"],
  "rad/s^3": [180 / Math.PI, "°/s³"],
  stitch: [1, "stitches"],
  "": [100, "%"],
};

/** The sentence of each criterion, with its limit in place of the sign #. */
const SENTENCES: Record<string, string> = {
  path_deviation: "the plan stays within # of the programmed path",
  shaping_deviation: "the shaper moves the path by at most #",
  contour_error: "the tool stays within # of its path",
  turning_point_error: "{axis} turns round within # of its place",
  tracking_error: "{axis} follows its command within #",
  repeatability: "runs repeat within #",
  stitch_length_error: "stitches at most # too short or too long",
  stitch_placement_error: "stitches within # of their place",
  stitch_speed_error: "the speed in a stitch is off by at most #",
  seam_error: "the seam lies within # of its line",
  needle_time_error: "the needle keeps its time within #",
  stitch_residual: "{axis} swings at most # when the needle enters",
  residual_vibration: "the machine swings at most # along {axis} after a stop",
  settling_time: "the machine stands after at most #",
  end_position_error: "{axis} ends within # of its place",
  cycle_time: "a cycle takes at most #",
  laid_error: "the fibre lies within # of its place",
  velocity: "{axis} moves at most #",
  acceleration: "{axis} accelerates at most #",
  jerk: "{axis} changes its acceleration by at most #",
  progress_error: "the tool is at most # ahead of its plan or behind it",
  travel: "{axis} goes at most # beyond its travel",
  deceleration: "{axis} brakes at most #",
  path_use: "the motion uses at most # of the limits along the path",
  velocity_ripple: "the speed is off by at most #",
  stitches_to_speed: "full speed at most # after a corner",
  stitches_from_needle: "full speed at most # after the needle of a corner",
  needle_use: "the needle uses at most # of its acceleration",
  dac_saturation: "the controller of {axis} is at its limit for at most # of the time",
  step_loss: "the motor of {axis} needs at most # of its torque",
  current_peak: "the current of {axis} is at most #",
  current_rms: "the mean current of {axis} is at most #",
  switching_order: "at most # of the switchings are missing or out of order",
  switching_error: "switchings are off by at most #",
  switching_dwell: "a valve switches again at most # too soon",
  valve_conflict: "opposite valves are open together for at most #",
  over_level: "the flow controls exceed their level by at most #",
  servo_force: "{axis} needs at most # of its force",
  window_use: "a move needs at most # of the time while the needles are out of the cloth",
  step_rate: "{axis} steps at most at #",
  fetch_use: "loading a move takes at most # of the time between moves",
  slip_tendency: "the fibre is steered at most # of the force that presses it down",
  bridging: "the fibre spans hollows at most # high",
  free_length: "the free fibre is at most # long",
  slack: "the fibre goes slack by at most #",
  fibre_speed: "the fibre runs at most #",
  fibre_speed_variation: "the speed of the fibre varies by at most #",
  lifting: "at most # of the laid fibre is lifted again",
  clearance: "eye and arm come at most # too near to the mandrel",
  pattern_closure: "the pattern closes within #",
  coverage_gap: "gaps between the bands are at most # wide",
  tension_variation: "the tension of the fibre varies by at most #",
};
const PLANNED = "planned_";

/** A value with three significant digits, and its unit: "0.042 mm", "3.2 %". */
export function amount(value: number, unit: string): string {
  const [factor, shown] = UNITS[unit] ?? [1, unit];
  const size = value * factor;
  const whole = Math.abs(size) >= 100 ? 0 : Math.abs(size) >= 10 ? 1 : Math.abs(size) >= 1 ? 2 : 3;
  return `${size.toFixed(whole)} ${shown}`.trim();
}

/** A criterion in words: "the tool stays within 0.300 mm of its path: 0.042 mm". */
export function sentence(one: Criterion): string {
  const limit = one.limit === null ? "its limit" : amount(one.limit, one.unit);
  const planned = one.name.startsWith(PLANNED);
  const known = SENTENCES[planned ? one.name.slice(PLANNED.length) : one.name];
  const axis = one.axis || "the machine";
  const plain = `${one.name.replaceAll("_", " ")}${one.axis ? ` of ${one.axis}` : ""}, at most #`;
  const text = (planned ? `as planned, ${known ?? plain}` : (known ?? plain))
    .replace("{axis}", axis)
    .replace("#", limit);
  return `${text}: ${one.measured === null ? "not measured" : amount(one.measured, one.unit)}`;
}

/** A verdict in words: names of criteria without underscores, and its runs. */
export function verdictWords(closing: string): string {
  return closing
    .replace(/\((?:nominal|repeated): (\d+) (runs?)/, "($1 simulated $2")
    .replace(/((?:more than )?\d[\d.]* %) of ([^();]+) used/g, "$2 is at $1 of its limit")
    .replace(/[a-z]+(?:_[a-z]+)+/g, (name) => name.replaceAll("_", " "));
}

/** The verdict of a run of the machine, without the number of judged runs: it is this one. */
export function verdictOfRun(closing: string): string {
  const judged = closing.replace(/ \((?:nominal|repeated): 1 run\)/, "");
  const short = judged.replace(/: the run ended in operation \d+, .*$/, ": it did not reach its end");
  return verdictWords(short.replace(/\((?:nominal|repeated): 1 run; /, "("));
}

/** The verdict of a run of a machine that measures nothing: it says so in place of a list of criteria. */
export function verdictOfBlindRun(closing: string): string {
  const why = "nothing was measured, because this controller reports commanded positions only";
  return verdictOfRun(closing).replace(/(^NOT PROVEN[^:]*): [^;]+ (?:was|were) not measured/, `$1: ${why}`);
}

/** Whether a run ended in trouble: out of spec, by a fault, or without a judge. NOT PROVEN is none of these. */
export function inTrouble(run: { ended: string | null; verdict: string }): boolean {
  return run.ended === "fault" || /^(OUT|out|NOT JUDGED)/.test(run.verdict);
}

/** The used share of a limit; null where there is none. */
export function used(one: Criterion): number | null {
  if (one.measured === null || one.limit === null || one.limit === 0) return null;
  return Math.abs(one.measured / one.limit);
}

/** The result with the largest used share of each criterion and axis; failed ones first. */
export function worst(criteria: Criterion[]): Criterion[] {
  const found = new Map<string, Criterion>();
  for (const one of criteria) {
    if (used(one) === null) continue;
    const key = `${one.name} ${one.axis}`;
    const other = found.get(key);
    if (!other || used(one)! > used(other)!) found.set(key, one);
  }
  const order = (one: Criterion) => (one.status === "failed" ? 1000 : 0) + used(one)!;
  return [...found.values()].sort((a, b) => order(b) - order(a));
}

/** Criteria of a verdict that are listed, failed ones beside. */
const MOST_CRITERIA = 8;

/** The criteria that are nearest to their limits, all failed ones among them; and how many others there are. */
export function nearest(criteria: Criterion[]): { shown: Criterion[]; others: string } {
  const all = worst(criteria);
  const failed = all.filter((one) => one.status === "failed").length;
  const shown = all.slice(0, Math.max(MOST_CRITERIA, failed));
  const others = all.length - shown.length;
  const words = counted(others, "other criterion is", "other criteria are");
  return { shown, others: others ? `${words} farther from the limit` : "" };
}

/** Whether a run is one of a program, by its file: a winding and a cycle have names of their own. */
export function isOf(program: string, run: { file: string }): boolean {
  return program === run.file;
}

/** A time for people: "0:07", "12:30", "2:05:00". */
export function clock(seconds: number): string {
  const whole = Math.max(Math.ceil(seconds - 1e-9), 0);
  const parts = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  const shown = parts[0] ? parts : parts.slice(1);
  return shown.map((one, k) => (k ? String(one).padStart(2, "0") : String(one))).join(":");
}

/** A number of things: "1 stitch", "185 stitches". */
export function counted(number: number, one: string, many = `${one}s`): string {
  return `${number} ${number === 1 ? one : many}`;
}

const TIME_OF_DAY = new Intl.DateTimeFormat([], { hour: "numeric", minute: "2-digit" }); // to make one costs much

/** The time of day after some seconds: "13:07", or "1:07 PM" where people write it so. */
export function timeOfDay(after_s: number, now = new Date()): string {
  const then = new Date(now.getTime() + 1000 * after_s);
  return TIME_OF_DAY.format(then);
}

/** Index of the last time that is not later than a time; -1 before the first. */
export function before(times: ArrayLike<number>, time: number): number {
  let [low, high] = [0, times.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle]! <= time) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

const NOT_HOMED = new Set(["connecting", "disabled", "enabled", "homing", "fault", "gone"]);

/** Whether a machine in a state is homed. */
export function isHomed(state: string): boolean {
  return !NOT_HOMED.has(state);
}

/** Text in place of an unknown position. */
export function unknownPlace(homed: boolean): string {
  return homed ? "told in a run" : "not homed";
}

/** Why a position is not known, and what to do. */
export function whyUnknown(homed: boolean): string {
  return homed
    ? "This machine tells positions, contacts and outputs only while a program runs."
    : "Not homed: press Enable, then Home all. Positions, contacts and outputs are known then.";
}
