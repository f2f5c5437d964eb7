// Answers so many states of a robot, each after computing for so long, and tells what became of it.
const [client, host, port, robot, compute_s, count] = process.argv.slice(2);
const { Client } = await import(client);
const outcomes = [];
let lab;
try {
  lab = await Client.connect({ host, port: Number(port) });
  await lab.acquire(robot);
  let sent = 0;
  for await (const state of lab.states()) {
    const end_ms = performance.now() + 1000 * compute_s;
    while (performance.now() < end_ms);
    await lab.send([1e-4, ...state.q_cmd.slice(1).fill(0)]);
    outcomes.push(...lab.newVerdicts().map((verdict) => verdict.outcome));
    if (++sent >= count) break;
  }
  console.log(`sent ${count}: ${outcomes.join(" ")}`);
} catch (error) {
  console.error(error.message);
  process.exitCode = 1;
} finally {
  await lab?.close();
}
