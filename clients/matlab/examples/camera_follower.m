function camera_follower(host, port, duration_s, distance_m)
% Keep the floor robot's camera on the tool of the gantry robot, for MATLAB and GNU Octave alike.
%
% The law of Bjerkeng et al., "Active camera control with obstacle avoidance" (III): the view direction first, then in
% its null space the view distance, the camera's roll, and a repulsion from the leader's tool and from the floor. The
% numbers are the paper's equations; where its print is wrong, they are corrected as in the camera follower in Python.
% It knows no bodies but these two: whatever else comes near is the gate's to keep apart.
%
%   addpath('clients/matlab', 'clients/matlab/examples'); camera_follower('127.0.0.1', 5210, 30)
    if nargin < 1, host = '127.0.0.1'; end
    if nargin < 2, port = 5210; end
    if nargin < 3, duration_s = Inf; end
    if nargin < 4, distance_m = 1.25; end
    lab = deltaq.Client(host, port, getenv('DELTAQ_CLIENT_TOKEN'), 'camera-follower');
    finish = onCleanup(@() lab.close());
    camera = deltaq.kinematics(lab.describe(), 'fr', 'camera');
    lab.acquire('fr');
    arm = lab.robots.fr;
    arm.max_dq = (1 - 1e-6) * arm.max_increment;
    arm.max_ddq = (1 - 1e-6) * arm.max_acceleration * lab.cycle_s^2;
    horizon_s = 0.06;  % of the integration, III-F: an increment reaches as far as all of it would
    goal = struct('distance', distance_m, 'share', lab.cycle_s / horizon_s);
    focus = [];
    state = lab.next_state();
    begin_s = state.time_s;
    while state.time_s - begin_s < duration_s
        leader = lab.newest('gr');
        if ~isempty(leader)
            focus = tracked(focus, leader);
            goal.focus = focus.position + 0.06 * focus.velocity;  % where it is when the increment takes effect
            goal.speed = norm(focus.velocity);
            [q, dq_last] = lab.ahead();
            [k1, J] = rates(camera, arm, goal, q);
            k2 = rates(camera, arm, goal, q + horizon_s / 2 * k1);  % classical Runge-Kutta, (16)
            k3 = rates(camera, arm, goal, q + horizon_s / 2 * k2);
            k4 = rates(camera, arm, goal, q + horizon_s * k3);
            dq = horizon_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
            lab.send(within_limits(dq, dq_last, arm, J), state.cycle);
        end
        state = lab.next_state();
    end
    outcomes = cellfun(@(verdict) verdict.outcome, lab.new_verdicts(), 'UniformOutput', false);
    fprintf('followed for %.1f s: %d of %d increments admitted as they were asked for\n', ...
        state.time_s - begin_s, sum(strcmp(outcomes, 'admitted')), numel(outcomes));
end

function [dq, J_t] = rates(camera, arm, goal, q)
% The law (9) with its sub-tasks: joint rates (n,1) over the horizon, and the task's Jacobian of (4).
    [T, J] = camera(q);
    R = T(1:3, 1:3);
    x = T(1:3, 4);
    d = norm(goal.focus - x);
    u = (goal.focus - x) / d;
    y = R' * u;
    y(3) = max(y(3), 1e-6 - 1);  % straight behind, (3) is 0/0
    psi = y(1:2) / (1 + y(3));   % (3): its norm is tan(angle / 2)
    angle = 2 * atan(norm(psi));
    stretch = (1 + psi' * psi) / 2;
    u_across = [0 -u(3) u(2); u(3) 0 -u(1); -u(2) u(1) 0];
    J_t = [eye(2), -psi] / (1 + y(3)) * R' * (u_across * J(4:6, :) - (J(1:3, :) - u * (u' * J(1:3, :))) / d);
    task = -stretch * bounded(30 * angle, angle, 10, goal.speed / d, goal.share) * psi / max(norm(psi), 1e-12);

    above = max(q - arm.lower, 1e-3 * (arm.upper - arm.lower));  % (10) and (11): joints near a limit weigh more
    below = max(arm.upper - q, 1e-3 * (arm.upper - arm.lower));
    H = ((arm.upper - arm.lower) ./ (above .* below)) .^ 2 .* (above - below);
    w = 1 ./ (1 + (pi / 180 * H) .^ 2);
    damping = (0.03 * stretch) ^ 2 * eye(2);
    solved = @(w, task, F) w .* (F + J_t' * ((J_t * (w .* J_t') + damping) \ (task - J_t * (w .* F))));

    approach = J(1:3, :)' * u;  % (14): each view distance at the same rate, whatever the posture
    far = d - goal.distance;
    mobility = max(approach' * solved(w, [0; 0], approach), 0.05);
    F = sign(far) * bounded(25 * abs(far), abs(far), 2, goal.speed, goal.share) / mobility * approach;
    clear = [d - 0.25, x(3)];   % (12): the lens from the leader's tool and from the floor
    away = [-u, [0; 0; 1]];
    for near = find(clear < 0.3)
        c = max(clear(near), 0.03);
        F = F + 2e-3 * (1 / c - 1 / 0.3) / c ^ 2 * J(1:3, :)' * away(:, near);
    end
    level = R(3, 1) ^ 2 + R(3, 2) ^ 2;  % (15): how fast the last joint turns the picture decides the sign
    across = J(4, end) * R(2, 1:2) - J(5, end) * R(1, 1:2);
    effect = (R(3, 1) * across(2) - R(3, 2) * across(1)) / max(level, 0.01);
    roll = atan2(R(3, 2), R(3, 1));
    if abs(effect) > 0.1
        F(end) = F(end) - sign(roll / effect) * bounded(15 * abs(roll), abs(roll), 30, 0, goal.share);
    end
    dq = solved(w, task, F);
    leaves = H .* dq < 0 & w < 0.99;
    if any(leaves)
        w(leaves) = 1;  % a joint that leaves its limit is not weighed
        dq = solved(w, task, F);
    end
end

function rate = bounded(rate, err, deceleration, ahead, share)
% Not faster than can be braked.
    rate = min(rate, share * (ahead + sqrt(2 * deceleration * err)));
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
    if isempty(focus), focus = struct('position', position, 'velocity', zeros(3, 1), 'time_s', leader.time_s); end
    elapsed = leader.time_s - focus.time_s;
    if elapsed > 0
        ahead = focus.position + elapsed * focus.velocity;
        focus.velocity = focus.velocity + 0.4 / elapsed * (position - ahead);
        focus.position = ahead + 0.7 * (position - ahead);
        focus.time_s = leader.time_s;
    end
end
