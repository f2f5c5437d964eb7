classdef InFlight < handle
% What a controller has sent and no state shows yet. Arithmetic without a clock: verdicts may come late, or never.

    properties (Access = private)
        rows = [];         % of each increment: seq, cycle that it answers, cycle that it goes into (NaN: undecided), dq
        cycle = -1;        % of the newest state
        first = 0;         % cycle of the first setpoint that is not decided, as the newest state tells
        lookahead = 1;     % most cycles from a state to the setpoint that its answer goes into
        q = [];            % (n,1) setpoint that the newest state tells [rad or m]
        dq = [];           % (n,1) increment that led to it
        answered = -1;     % newest cycle that was answered
        playout = [];      % of the newest state, where the lease has a jitter buffer
    end

    properties (SetAccess = private)
        given_up = 0;      % increments whose verdict never came
    end

    methods
        function sent(obj, seq, cycle, dq)
            obj.answered = max(obj.answered, cycle);
            row = [seq, cycle, NaN, double(dq(:)')];
            if numel(dq) == numel(obj.q) && all(isfinite(row([1 2 4:end])))  % others are refused
                obj.rows(end + 1, 1:numel(row)) = row;
            end
        end

        function take_verdict(obj, verdict)
            if isempty(obj.rows) || strcmp(verdict.outcome, 'carried'), return, end  % states say what is owed
            row = find(obj.rows(:, 1) == verdict.seq, 1);
            if isempty(verdict.setpoint_cycle)
                obj.rows(row, :) = [];  % refused or held: it goes into nothing
            elseif ~isempty(row)
                obj.rows(row, 3:end) = [verdict.setpoint_cycle, verdict.dq(:)'];
                older = isnan(obj.rows(:, 3)) & obj.rows(:, 1) < verdict.seq;
                obj.forget(older);  % their verdicts were lost: the next states show what became of them
            end
        end

        function take_state(obj, state)
            q = state.q_cmd;
            first = state.cycle + 1;
            if ~isempty(state.q_ahead)
                q = state.q_ahead;
                first = state.setpoint_cycle;
            end
            passed = state.cycle - obj.cycle;
            if isempty(obj.q) || passed < 0 || any(strcmp(state.phase, {'held', 'offline'}))
                obj.rows = [];
                obj.answered = -1;
                obj.q = q;  % it begins at rest
                obj.dq = zeros(size(q));
                passed = 1;
            elseif passed > 0
                obj.dq = (q - obj.q) / passed;
            end
            lookahead = max(obj.lookahead, first - state.cycle);
            obj.playout = state.playout;
            if ~isempty(obj.playout) && ~isempty(obj.rows)
                shown = obj.playout.answered_cycle;
                if ~isempty(shown), obj.rows(obj.rows(:, 2) <= shown, :) = []; end
                longest = 2 * obj.playout.delay_cycles + 4;
                obj.forget(obj.rows(:, 2) <= state.cycle - longest);
            elseif ~isempty(obj.rows)
                rows = obj.rows;
                undecided = find(isnan(rows(:, 3)), 1);
                if passed > 0 && ~isempty(undecided) && max(abs(obj.q' + rows(undecided, 4:end) - q')) < 1e-12
                    rows(undecided, :) = [];  % shown before its verdict has come
                end
                rows(rows(:, 3) < first, :) = [];
                obj.rows = rows;
                obj.forget(isnan(rows(:, 3)) & rows(:, 2) <= state.cycle - lookahead - 4);
            end
            obj.q = q;
            obj.cycle = state.cycle;
            obj.lookahead = lookahead;
            obj.first = first;
        end

        function [q, dq, cycle] = ahead(obj)
        % The setpoint that the next increment is added to, the increment that leads to it, and the setpoint's cycle.
            q = obj.q;
            dq = obj.dq;
            cycle = obj.first - 1;
            if ~isempty(obj.playout), cycle = cycle + obj.playout.delay_cycles; end
            if ~isempty(obj.playout) && ~isempty(obj.playout.owed)
                q = q + obj.playout.owed(:);  % of increments that came late
            end
            if isempty(obj.rows), return, end
            if ~isempty(obj.playout)  % the state says what is in its setpoint: all else is on its way
                q = q + sum(obj.rows(:, 4:end), 1)';
                dq = obj.rows(end, 4:end)';
                return
            end
            undecided = find(isnan(obj.rows(:, 3)));
            undecided = undecided(max(1, end - obj.lookahead + 1):end);
            counted = obj.rows([find(~isnan(obj.rows(:, 3))); undecided], 3:end);
            if ~isempty(counted)
                q = q + sum(counted(:, 2:end), 1)';
                dq = counted(end, 2:end)';
                cycle = max([cycle; counted(:, 1)]) + numel(undecided);
            end
        end

        function cycles = cycles_to_answer(obj)
        % That of the newest state, and of states before it that were missed, for whose answers a lookahead or a playout
        % buffer has room.
            [~, ~, ahead] = obj.ahead();
            missed = 0;
            if obj.answered >= 0, missed = max(0, obj.cycle - obj.answered - 1); end
            room = obj.cycle + obj.lookahead - ahead;
            if ~isempty(obj.playout), room = 5; end  % what is older comes too late for its turn
            count = min(max(1, room), 1 + missed);
            cycles = obj.cycle - count + 1:obj.cycle;
        end
    end

    methods (Access = private)
        function forget(obj, which)
            obj.given_up = obj.given_up + sum(which);
            obj.rows(which, :) = [];
        end
    end
end
