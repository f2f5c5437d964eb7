classdef Client < handle
% A connection to a running cell over lines of JSON, for MATLAB (R2020b on) and GNU Octave alike.
%
%   lab = deltaq.Client('127.0.0.1', 5210);
%   finish = onCleanup(@() lab.close());    % however this ends, the lease is given back
%   lab.acquire('fr');
%   for step = 1:100
%       state = lab.next_state();           % the newest there is; waits for it
%       lab.send([5e-4 0 0 0 0 0]);         % rad (or m) in one cycle, in answer to the newest state
%   end
%
% A client holds one lease at a time. It waits for no verdict: those that have come are in new_verdicts(), and
% ahead() reckons with what is still on its way. The lease is renewed by every call of next_state() and send(); a
% controller that computes for longer than half of lease_s calls renew() meanwhile. What is refused is an error,
% deltaq:CODE, whose message says what to do. Octave needs its package instrument-control.

    properties (SetAccess = private)
        cell_name = '';      % of the cell
        cycle_s = NaN;       % [s]
        robots = struct();   % by name: joints, units, limits in joint order [rad or m]
        robot = '';          % whose lease is held
        lease_s = Inf;       % silence after which the lease runs out [s]
    end

    properties (Access = private)
        socket = [];
        address = '';
        received = '';       % what came after the last end of a line
        states = {};         % newest of each robot
        of_robot = {};       % which robots those are
        answered_cycle = -1; % of the state that next_state() returned last
        verdicts = {};
        answers = {};        % what is neither a state nor a verdict
        seq = 0;
        sent_at = uint64(0);
        in_flight = [];      % deltaq.InFlight
    end

    methods
        function obj = Client(host, port, token, name)
        % Connect. The token is needed where the cell asks for one; by default it is that of the environment, if there
        % is any (deltaq.given_token). Others see the name.
            if nargin < 1, host = '127.0.0.1'; end
            if nargin < 2, port = 5210; end
            if nargin < 3, token = deltaq.given_token(); end
            if nargin < 4, name = 'matlab'; end
            obj.address = sprintf('%s:%d', char(host), port);
            obj.in_flight = deltaq.InFlight();
            obj.socket = connected(char(host), port, obj.address);
            hello = struct('type', 'hello', 'protocol', int64(3), 'client', char(name));
            if ~isempty(char(token)) % it is shown and not sent: somebody else may listen at this port
                given = obj.ask(struct('type', 'challenge'), @(answer) strcmp(answer.type, 'challenge'));
                hello.challenge = given.challenge;
                hello.proof = deltaq.hmac_sha256(char(token), ['deltaq hello ' given.challenge]);
            end
            welcome = obj.ask(hello, @(answer) strcmp(answer.type, 'welcome'));
            [obj.cell_name, obj.cycle_s, obj.robots] = deal(welcome.cell, welcome.cycle_s, welcome.robots);
        end

        function acquire(obj, robot, playout)
        % Take the lease of a robot; playout: true from farther away than a cycle, increments then wait for their turn.
            if nargin < 3, playout = false; end
            robot = char(robot);
            if ~isfield(obj.robots, matlab.lang.makeValidName(robot))
                error('deltaq:unknown_robot', '%s', sprintf('cell %s has no robot ''%s''; it has %s', ...
                    obj.cell_name, robot, strjoin(fieldnames(obj.robots)', ', ')));
            elseif ~isempty(obj.robot)
                error('deltaq:lease_taken', '%s', sprintf( ...
                    'this client holds the lease of %s; release it, or connect a second client', obj.robot));
            end
            lease = obj.ask(request('lease', robot, 'action', 'acquire', 'playout', logical(playout)), @(answer) strcmp(answer.type, 'lease'));
            if ~lease.granted
                why = 'needs a controller''s token';
                if ~isempty(lease.holder), why = ['is held by ' lease.holder]; end
                error(['deltaq:' lease.code], '%s', sprintf('the lease of %s %s (%s)', robot, why, lease.code));
            end
            obj.robot = robot;
            obj.lease_s = lease.expires_s;
            obj.answered_cycle = -1;
            obj.in_flight = deltaq.InFlight();
            if ~isempty(obj.newest(robot)), obj.in_flight.take_state(obj.newest(robot)); end
        end

        function state = next_state(obj)
        % The newest state of the robot that is leased, once there is a newer one than last time.
            obj.need_lease();
            state = obj.newest(obj.robot);
            if ~isempty(state) && state.cycle ~= obj.answered_cycle
                obj.take_lines(false);
                state = obj.newest(obj.robot);
            end
            while isempty(state) || state.cycle == obj.answered_cycle
                obj.keep_lease();
                obj.take_lines(true);
                state = obj.newest(obj.robot);
            end
            obj.keep_lease();
            obj.answered_cycle = state.cycle;
        end

        function state = newest(obj, robot)
        % The newest state of any robot that has come, [] before the first.
            state = [];
            index = find(strcmp(obj.of_robot, robot), 1);
            if ~isempty(index), state = obj.states{index}; end
        end

        function [q, dq] = ahead(obj)
        % The setpoint (n,1) that the next increment is added to, what is on its way included, and the increment
        % (n,1) that leads to it [rad or m].
            [q, dq] = obj.in_flight.ahead();
        end

        function cycles = cycles_to_answer(obj)
        % Cycles for which to send() now: the newest state's, and in a cell with a lookahead those of states that were
        % missed, as long as there is room for their answers.
            cycles = obj.in_flight.cycles_to_answer();
        end

        function seq = send(obj, dq, cycle)
        % Ask for an increment (n) [rad or m] in answer to the state of a cycle; the newest that has come if none is
        % given, so that one who computes for long is not refused for it. Returns its sequence number.
            obj.need_lease();
            if nargin < 3
                obj.take_lines(false);
                state = obj.newest(obj.robot);
                if isempty(state), state = obj.next_state(); end
                cycle = state.cycle;
            end
            seq = obj.seq + 1;
            obj.seq = seq;
            % a cell array, so that a single number is a list too
            obj.say(request('increment', obj.robot, 'seq', int64(seq), 'cycle', int64(cycle), ...
                'dq', {num2cell(double(dq(:)'))}));
            obj.in_flight.sent(seq, cycle, dq);
        end

        function verdicts = new_verdicts(obj)
        % Verdicts that have come since the last call, a cell array; of two on one seq the last counts.
            verdicts = obj.verdicts;
            obj.verdicts = {};
        end

        function count = given_up(obj)
        % How many increments of this lease have had no verdict in time: they are not waited for.
            count = obj.in_flight.given_up;
        end

        function renew(obj)
        % Say that the lease is still needed; for one who computes for long.
            obj.say(request('lease', obj.robot, 'action', 'renew'));
        end

        function stop(obj)
        % Bring every robot of the cell to rest; each is held until it is reset.
            obj.ask(struct('type', 'stop'), @(answer) strcmp(answer.type, 'done'));
        end

        function reset(obj, robot)
        % Leave `held`.
            obj.ask(request('reset', char(robot)), @(answer) strcmp(answer.type, 'done'));
        end

        function description = describe(obj)
        % The cell's description: YAML, URDF, and its kinematics, which deltaq.kinematics reads.
            description = obj.ask(struct('type', 'describe'), @(answer) strcmp(answer.type, 'description'));
        end

        function release(obj)
        % Give the lease back, and read the answer: who closes before it has come looks like one that was lost.
            if isempty(obj.robot), return, end
            robot = obj.robot;
            obj.ask(request('lease', robot, 'action', 'release'), ...
                @(answer) strcmp(answer.type, 'lease') && isempty(answer.holder));
            obj.robot = '';
        end

        function close(obj)
        % Give the lease back and disconnect; may be called twice, and when the server has gone.
            if isempty(obj.socket), return, end
            try
                obj.release();
            catch problem
                warning(problem.identifier, '%s', problem.message);
            end
            obj.robot = '';
            obj.socket = [];
        end
    end

    methods (Access = private)
        function need_lease(obj)
            if isempty(obj.robot)
                error('deltaq:lease_not_held', '%s', 'no lease is held: acquire that of a robot first');
            end
        end

        function keep_lease(obj)
            if toc(obj.sent_at) > 0.3 * obj.lease_s, obj.renew(); end
        end

        function answer = ask(obj, message, is_answer)
            obj.answers = {};
            obj.say(message);
            while true
                obj.take_lines(true);
                for index = 1:numel(obj.answers)
                    answer = obj.answers{index};
                    if is_answer(answer), return, end
                end
            end
        end

        function say(obj, message)
            if isempty(obj.socket), error('deltaq:unreachable', '%s', 'this client is closed'); end
            try
                write(obj.socket, uint8([jsonencode(message) char(10)]));
            catch problem
                obj.gone(problem.message);
            end
            obj.sent_at = tic();
        end

        function take_lines(obj, wait)
        % Read all that has come, and at least something if told to wait for it. Not one line is left out, nor the
        % beginning of one whose end has not come.
            if isempty(obj.socket), error('deltaq:unreachable', '%s', 'this client is closed'); end
            bytes = uint8([]);
            try
                if wait, bytes = uint8(read(obj.socket, 1)); end
                count = obj.socket.NumBytesAvailable;
                if count > 0, rest = uint8(read(obj.socket, count)); bytes = [bytes(:)' rest(:)']; end
            catch problem
                obj.gone(problem.message);
            end
            if wait && isempty(bytes), obj.gone('nothing came for 2 s'); end
            obj.received = [obj.received char(bytes(:)')];
            ends = find(obj.received == 10);
            if isempty(ends), return, end
            lines = obj.received;
            obj.received = lines(ends(end) + 1:end);
            refusal = [];
            start = 1;
            for last = ends - 1
                message = jsondecode(lines(start:last));
                start = last + 2;
                switch message.type
                    case 'state'
                        obj.take_state(message);
                    case 'verdict'
                        obj.verdicts{end + 1} = message;
                        obj.in_flight.take_verdict(message);
                    case 'error'
                        if isempty(refusal), refusal = message; end  % told when every line has been read
                    otherwise
                        obj.answers{end + 1} = message;
                end
            end
            if ~isempty(refusal), obj.refused(refusal); end
        end

        function take_state(obj, state)
            index = find(strcmp(obj.of_robot, state.robot), 1);
            if isempty(index)
                index = numel(obj.states) + 1;
                obj.of_robot{index} = state.robot;
            end
            obj.states{index} = state;
            if strcmp(state.robot, obj.robot), obj.in_flight.take_state(state); end
        end

        function refused(obj, refusal)
        % The lease is lost, or a line could not be served.
            if strcmp(refusal.code, 'lease_not_held'), obj.robot = ''; end
            text = refusal.message;
            if ~isempty(refusal.hint), text = [text '; ' refusal.hint]; end
            error(['deltaq:' refusal.code], '%s', text);
        end

        function gone(obj, why)
            obj.robot = '';
            obj.socket = [];
            error('deltaq:unreachable', '%s', sprintf('%s does not answer any more (%s); the robot comes to rest', ...
                obj.address, strtrim(why)));
        end
    end
end

function message = request(type, robot, varargin)
    message = struct('type', type, 'robot', robot, varargin{:});
end

function socket = connected(host, port, address)
    try
        if exist('OCTAVE_VERSION', 'builtin')
            pkg('load', 'instrument-control');
            socket = tcpclient(host, port, 'Timeout', 2);
        else
            socket = tcpclient(host, port, 'Timeout', 2, 'ConnectTimeout', 5);
        end
    catch problem
        error('deltaq:unreachable', '%s', sprintf('no cell answers at %s: %s', address, strtrim(problem.message)));
    end
end
