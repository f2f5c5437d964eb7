function far_turn(host, port, angle)
% Turns A1 by an angle [rad] from farther away than a cycle, and tells how many cycles its answers waited.
    lab = deltaq.Client(host, port);
    finish = onCleanup(@() lab.close());
    lab.acquire('fr', true);
    step = pi / 6 * lab.cycle_s;
    state = lab.next_state();
    target = state.q_cmd(1) + angle;
    delay = 0;
    there = 0;
    settled = 20; % states: longer than anything that was given up for lost can still be on its way
    while there <= settled
        if abs(target - state.q_cmd(1)) < 1e-3
            there = there + 1;
        else
            there = 0;
        end
        for cycle = lab.cycles_to_answer()
            q = lab.ahead();
            lab.send([max(-step, min(step, 0.2 * (target - q(1)))), 0, 0, 0, 0, 0], cycle);
        end
        state = lab.next_state();
        delay = max(delay, state.playout.delay_cycles);
    end
    fprintf('delay %d\n', delay);
end
