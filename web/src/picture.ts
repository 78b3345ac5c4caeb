/** The data of the view, and the picture that draws them: each kind of work has its own. */

import type { Figures, Mandrel, State } from "./messages";

/** The drawn data of a job: its path, without times before it is calculated. */
export interface Shown {
  program: string;
  proof: string;
  planned: Record<string, number[]>;
  times_s: number[];
  duration_s: number;
  mandrel: Mandrel | null;
  stitches: Figures["stitches"];
  steps: Figures["steps"];
  lanes: Figures["lanes"];
}

/** A picture of one kind of work. */
export interface Picture {
  readonly element: HTMLElement;
  /** Whether a point of view can be chosen. */
  readonly turns: boolean;
  /** See it larger by a factor, all of it with 0; none where all of it is always seen. */
  readonly zoom?: (factor: number) => void;
  show(shown: Shown | null, mandrel: Mandrel | null): void;
  /** Show the machine in a state. */
  live(state: State): void;
  /** Show the planned job at a time; null for none. */
  at(time_s: number): void;
  /** What the colours mean. */
  legend(): [string, string][];
  draw(): void;
  resize(): void;
}
