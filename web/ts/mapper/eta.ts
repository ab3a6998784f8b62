/** How much of a map is made, and how long the rest may take. */
import type { StageEvent } from "./protocol.js";
import type { MapProgress, MapStage } from "./types.js";

/** Shares of the whole that the stages usually take; measured on 115 pictures of a kitchen, one thread. */
const shares: readonly (readonly [MapStage, number])[] = [
  ["pairs", 0.17],
  ["matching", 0.12],
  ["poses", 0.09],
  ["refine", 0.11],
  ["points", 0.31],
  ["lines", 0.18],
  ["landmarks", 0.01],
  ["write", 0.01],
];

/** Before so much is done nothing can be said about the rest. */
const leastShare = 0.03;

export class Eta {
  readonly #startedAt = performance.now();
  #share = 0;

  progress({ stage, done, total }: StageEvent): MapProgress {
    let before = 0;
    for (const [name, share] of shares) {
      if (name === stage) {
        before += share * Math.min(1, done / Math.max(1, total));
        break;
      }
      before += share;
    }
    // "poses" and "refine" take turns.
    this.#share = Math.max(this.#share, Math.min(before, 1));
    const progress: MapProgress = { stage, done, total, share: this.#share };
    if (this.#share >= leastShare) progress.etaSeconds = ((performance.now() - this.#startedAt) / 1000) * (1 / this.#share - 1);
    return progress;
  }

  get seconds(): number {
    return (performance.now() - this.#startedAt) / 1000;
  }
}
