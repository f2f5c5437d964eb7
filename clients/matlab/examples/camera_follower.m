function camera_follower(host, port, duration_s, distance_m)
% Keep the floor robot's camera on the tool of the gantry robot, for MATLAB and GNU Octave alike.
%
%   addpath('clients/matlab', 'clients/matlab/examples'); camera_follower('127.0.0.1', 5210, 30)
%
% The law of Bjerkeng et al., "Active camera control with obstacle avoidance" (III): the view direction first, then in
% its null space the view distance, the camera's roll, and a repulsion. The numbers are the paper's equations, as the
% follower in Python corrects them; in place of its integration over a horizon (16) an increment is one step in closed
% form. The repulsion knows the lens, the leader's tool and the floor; whatever else comes near is the gate's to stop.
    if nargin < 1, host = '127.0.0.1'; end
    if nargin < 2, port = 5210; end
    if nargin < 3, duration_s = Inf; end
    if nargin < 4, distance_m = 1.25; end
    lab = deltaq.Client(host, port, deltaq.given_token(), 'camera-follower');
    finish = onCleanup(@() lab.close());
    camera = deltaq.kinematics(lab.describe(), 'fr', 'camera');
    lab.acquire('fr');
    arm = lab.robots.fr;
    arm.max_dq = (1 - 1e-6) * arm.max_increment;
    arm.max_ddq = (1 - 1e-6) * arm.max_acceleration * lab.cycle_s ^ 2;
    focus = [];
    state = lab.next_state();
    begin_s = state.time_s;
    while state.time_s - begin_s < duration_s
        leader = lab.newest('gr');
        if ~isempty(leader)
            focus = tracked(focus, leader);
            p = focus.position + 0.06 * focus.velocity;  % where it is when the increment takes effect
            for cycle = lab.cycles_to_answer()  % usually one
                [q, dq_last] = lab.ahead();
                [T, J] = camera(q);
                [dq, J_t] = wanted(T, J, q, p, norm(focus.velocity), distance_m, arm, lab.cycle_s);
                lab.send(within_limits(dq, dq_last, arm, J_t), cycle);
            end
        end
        state = lab.next_state();
    end
    outcomes = cellfun(@(verdict) verdict.outcome, lab.new_verdicts(), 'UniformOutput', false);
    fprintf('followed for %.1f s: %d of %d increments admitted as they were asked for\n', ...
        state.time_s - begin_s, sum(strcmp(outcomes, 'admitted')), numel(outcomes));
end

function [dq, J_t] = wanted(T, J, q, p, speed, distance_m, arm, cycle_s)
% The law (9) with its sub-tasks as one increment (n,1), and the task's Jacobian of (4), (2,n).
    R = T(1:3, 1:3);
    x = T(1:3, 4);
    J_v = J(1:3, :);
    d = norm(p - x);
    u = (p - x) / d;
    y = R' * u;
    y(3) = max(y(3), 1e-6 - 1);  % straight behind, (3) is 0/0
    psi = y(1:2) / (1 + y(3));   % (3): its norm is tan(angle / 2)
    angle = 2 * atan(norm(psi));
    stretch = (1 + psi' * psi) / 2;
    u_across = [0 -u(3) u(2); u(3) 0 -u(1); -u(2) u(1) 0];
    J_t = [eye(2), -psi] / (1 + y(3)) * R' * (u_across * J(4:6, :) - (J_v - u * (u' * J_v)) / d);
    turn = min(0.83 * angle, cycle_s * (speed / d + sqrt(2 * 10 * angle)));  % not faster than can be braked
    task = -stretch * turn * psi / max(norm(psi), 1e-12);

    span = arm.upper - arm.lower;
    above = max(q - arm.lower, 1e-3 * span);  % (10) and (11): joints near a limit weigh more
    below = max(arm.upper - q, 1e-3 * span);
    H = (span ./ (above .* below)) .^ 2 .* (above - below);
    w = 1 ./ (1 + (pi / 180 * H) .^ 2);
    damping = (0.03 * stretch) ^ 2 * eye(2);
    solved = @(w, task, F) w .* (F + J_t' * ((J_t * (w .* J_t') + damping) \ (task - J_t * (w .* F))));

    approach = J_v' * u;  % (14): the same rate in every posture
    far = d - distance_m;
    zoom = min(0.78 * abs(far), cycle_s * (speed + sqrt(2 * 2 * abs(far))));
    F = sign(far) * zoom / max(approach' * solved(w, [0; 0], approach), 0.05) * approach;
    gap = max([d - 0.25, x(3)], 0.03);  % (12): the lens from the leader's tool and from the floor
    away = [-u, [0; 0; 1]];
    for near = find(gap < 0.3)
        F = F + 1.2e-4 * (1 / gap(near) - 1 / 0.3) / gap(near) ^ 2 * J_v' * away(:, near);
    end
    level = max(R(3, 1) ^ 2 + R(3, 2) ^ 2, 0.01);  % (15): how the last joint turns the picture decides the sign
    across = J(4, end) * R(2, 1:2) - J(5, end) * R(1, 1:2);
    effect = (R(3, 1) * across(2) - R(3, 2) * across(1)) / level;
    roll = atan2(R(3, 2), R(3, 1));
    if abs(effect) > 0.1
        F(end) = F(end) - sign(roll / effect) * min(0.59 * abs(roll), cycle_s * sqrt(2 * 30 * abs(roll)));
    end
    dq = solved(w, task, F);
    leaves = H .* dq < 0 & w < 0.99;
    if any(leaves)
        w(leaves) = 1;  % a joint that leaves its limit is not weighed
        dq = solved(w, task, F);
    end
end

function dq = within_limits(wanted, dq_last, arm, J_t)
% Within speed and acceleration; joints with room left make up for what the view loses by that.
    slowest = max(min(dq_last - arm.max_ddq, arm.max_dq), -arm.max_dq);
    fastest = min(max(dq_last + arm.max_ddq, -arm.max_dq), arm.max_dq);
    dq = min(max(wanted, slowest), fastest);
    for pass = 1:3
        free = double(dq > slowest & dq < fastest);
        if all(free) || ~any(free), break, end
        made_up = free .* (J_t' * ((J_t * (free .* J_t') + 1e-3 * eye(2)) \ (J_t * (wanted - dq))));
        dq = min(max(dq + made_up, slowest), fastest);
    end
end

function focus = tracked(focus, leader)
% Position and velocity of the leader's tool, by an alpha-beta filter.
    position = leader.tool.position;
    if isempty(focus), focus = struct('position', position, 'velocity', [0; 0; 0], 'time_s', leader.time_s); end
    elapsed = leader.time_s - focus.time_s;
    if elapsed > 0
        ahead = focus.position + elapsed * focus.velocity;
        focus.velocity = focus.velocity + 0.4 / elapsed * (position - ahead);
        focus.position = ahead + 0.7 * (position - ahead);
        focus.time_s = leader.time_s;
    end
end
