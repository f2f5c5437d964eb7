function turn_a1(host, port)
% Turn A1 of the floor robot by 10 degrees at 30 degrees/s, for MATLAB and GNU Octave alike.
%
%   addpath('clients/matlab', 'clients/matlab/examples'); turn_a1('127.0.0.1', 5210)
    if nargin < 1, host = '127.0.0.1'; end
    if nargin < 2, port = 5210; end
    lab = deltaq.Client(host, port, deltaq.given_token(), 'turn-a1');
    finish = onCleanup(@() lab.close());
    lab.acquire('fr');
    step = pi / 6 * lab.cycle_s;  % [rad] in one cycle
    lab.next_state();
    q = lab.ahead();
    target = q(1) + pi / 18;
    seq = 0;
    while abs(target - q(1)) > 1e-3
        dq = zeros(size(q));
        dq(1) = max(-step, min(step, 0.2 * (target - q(1))));
        seq = lab.send(dq);
        state = lab.next_state();
        if strcmp(state.phase, 'held')
            error('deltaq:held', 'fr is held: %s; when it is safe, `deltaq reset --robot fr`', state.reason);
        end
        q = lab.ahead();
    end
    fprintf('A1 is at %.2f deg after %d increments\n', q(1) * 180 / pi, seq);
end
