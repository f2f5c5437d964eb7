// Turn A1 of the floor robot by 10 degrees at 30 degrees/s: node turn_a1.mjs [HOST [PORT]]
import { Client } from "./deltaq.mjs";

const [host = "127.0.0.1", port = "5210"] = process.argv.slice(2);
let lab;
try {
  lab = await Client.connect({ host, port: Number(port), name: "turn-a1" });
  await lab.acquire("fr");
  const step = (Math.PI / 6) * lab.welcome.cycle_s; // [rad] in one cycle
  let target, seq, q;
  for await (const state of lab.states()) {
    if (state.phase === "held") throw new Error(`fr is held: ${state.reason}; when it is safe, \`deltaq reset --robot fr\``);
    q = state.q_ahead ?? state.q_cmd;
    target ??= q[0] + Math.PI / 18;
    const left = target - q[0];
    if (Math.abs(left) < 1e-3) break;
    seq = await lab.send([Math.max(-step, Math.min(step, 0.2 * left)), ...q.slice(1).fill(0)]);
    for (const { outcome, reasons } of lab.newVerdicts()) {
      if (outcome !== "admitted") console.log(outcome, ...reasons.map((reason) => reason.code));
    }
  }
  console.log(`A1 is at ${((q[0] * 180) / Math.PI).toFixed(2)} deg after ${seq} increments`);
} catch (error) {
  console.error(error.message);
  process.exitCode = 1;
} finally {
  await lab?.close();
}
