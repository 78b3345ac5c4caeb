/** The messages of the panel that the page uses; docs/panel-protocol.json is their schema. */

export interface Axis { name: string; unit: "m" | "rad"; low: number | null; high: number | null; manual_feed: number }
export interface Mandrel { axis: string; along: string; at: number[]; radius: number[] }
export interface Welcome { type: "welcome"; client: number; machine: string; title: string; link: string; simulated: boolean; label: string; lacks: Record<string, string>; notes: string[]; untaught: string; by_hand: boolean; options: string[]; axes: Axis[]; mandrel: Mandrel | null; jog_lease_s: number; control_lease_s: number }
export interface Where { commanded: number | null; measured: number | null; load: number | null }
export interface Holder { client: number | null; name: string; left_s: number; asks: number | null; asks_name: string; passes_in_s: number }
export interface Progress { run: string; program: string; time_s: number; duration_s: number; ended: string | null; why: string; verdict: string }
export interface Proven { program: string; proof: string; passed: boolean; closing: string }
export interface RestOfRun { run: string; told: string[] }
export interface State { type: "state"; seq: number; state: string; why: string; allowed: string[]; age_s: number; time_s: number; axes: Record<string, Where>; signals: Record<string, number>; late_ticks: number; control: Holder; progress: Progress | null; rest: RestOfRun | null; proven: Proven | null; calculating: number | null; busy: string; clients: number }
export interface Criterion { name: string; axis: string; measured: number | null; limit: number | null; unit: string; status: string }
export interface Figures { type: "figures"; program: string; proof: string; passed: boolean; closing: string; duration_s: number; feed: string | null; ticks: number | null; circuits: number | null; ticks_per_circuit: number | null; points: number; warnings: string[]; criteria: Criterion[]; times_s: number[]; planned: Record<string, number[]>; mandrel: Mandrel | null }
export interface Answer { type: "answer"; number: number; ok: boolean; text: string }
export interface Leased { type: "leased"; lease: string }
export interface Said { type: "said"; text: string; wrong: boolean }
export type FromPanel = Welcome | State | Figures | Answer | Leased | Said;
