// Increments in flight: sent, and not yet visible in a state, with a jitter buffer.
//
// Arithmetic without a clock: states say which increments their setpoint has, so no verdict has to come.

const MOST_CYCLES = 5; // that are answered at once; what is older comes too late for its turn
const PATIENCE_CYCLES = 4;

export class InFlight {
  #sent = []; #cycle = -1; #answered = -1;

  /** An increment (n) was sent in answer to the state of a cycle [rad or m]. */
  sent(seq, cycle, dq) {
    this.#answered = Math.max(this.#answered, cycle);
    if (dq.every(Number.isFinite)) this.#sent.push({ seq, cycle, dq: [...dq] }); // others are refused
  }
  /** What was refused goes into nothing. */
  takeVerdict({ seq, outcome }) {
    if (outcome === "refused") this.#sent = this.#sent.filter((one) => one.seq !== seq);
  }
  /** A state has come, with a `playout`. */
  takeState({ cycle, phase, playout }) {
    if (cycle < this.#cycle || phase === "held" || phase === "offline") { // what was sent before moves nothing
      this.#sent = [];
      this.#answered = -1;
    }
    this.#cycle = cycle;
    const shown = playout.answered_cycle ?? -1, given_up = cycle - 2 * playout.delay_cycles - PATIENCE_CYCLES;
    this.#sent = this.#sent.filter((one) => one.cycle > Math.max(shown, given_up));
  }
  /** The setpoint (n) that the next increment is added to [rad or m], if all that was sent has its turn. */
  ahead({ q_cmd, q_ahead, playout }) {
    const q = [...(q_ahead ?? q_cmd)];
    for (const dq of [playout.owed ?? [], ...this.#sent.map((one) => one.dq)]) dq.forEach((step, joint) => (q[joint] += step));
    return q;
  }
  /** The cycles for which to send now: that of the newest state, and of those before it that were missed. */
  cyclesToAnswer() {
    const missed = this.#answered < 0 ? 0 : Math.max(0, this.#cycle - this.#answered - 1);
    const count = Math.min(MOST_CYCLES, 1 + missed);
    return Array.from({ length: count }, (_, k) => this.#cycle - count + 1 + k);
  }
}
