// Turns A1 by an angle [rad] from farther away than a cycle, and tells how many cycles its answers waited.
const [client, host, port, angle] = process.argv.slice(2);
const { Client } = await import(client);
const SETTLED = 20; // states: longer than anything that was given up for lost can still be on its way
let lab;
try {
  lab = await Client.connect({ host, port: Number(port) });
  await lab.acquire("fr", { playout: true });
  const step = (Math.PI / 6) * lab.welcome.cycle_s;
  let target, delay = 0, there = 0;
  for await (const state of lab.states()) {
    target ??= state.q_cmd[0] + Number(angle);
    delay = Math.max(delay, state.playout.delay_cycles);
    there = Math.abs(target - state.q_cmd[0]) < 1e-3 ? there + 1 : 0;
    if (there > SETTLED) break;
    for (const cycle of lab.cyclesToAnswer()) {
      const left = target - lab.ahead(state)[0];
      await lab.send([Math.max(-step, Math.min(step, 0.2 * left)), 0, 0, 0, 0, 0], cycle);
    }
  }
  console.log(`delay ${delay}`);
} catch (error) {
  console.error(error.message);
  process.exitCode = 1;
} finally {
  await lab?.close();
}
