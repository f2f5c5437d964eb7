classdef InFlight < handle
% What a controller has sent and no state shows yet. Arithmetic without a clock: verdicts may come late, or never.

    properties (Access = private)
        rows = [];         % of each increment: seq, cycle that it answers, cycle that it goes into (NaN: undecided), dq
        cycle = -1;        % of the newest state
        lookahead = 1;     % cycles from a state to the setpoint that its answer goes into
        q = [];            % (n,1) setpoint that the newest state tells [rad or m]
        dq = [];           % (n,1) increment that led to it
    end

    properties (SetAccess = private)
        given_up = 0;      % increments whose verdict never came
    end

    methods
        function sent(obj, seq, cycle, dq)
            row = [seq, cycle, NaN, double(dq(:)')];
            if numel(dq) == numel(obj.q) && all(isfinite(row([1 2 4:end])))  % others are refused
                obj.rows(end + 1, 1:numel(row)) = row;
            end
        end

        function take_verdict(obj, verdict)
            if isempty(obj.rows), return, end
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
                obj.q = q;  % it begins at rest
                obj.dq = zeros(size(q));
                passed = 1;
            elseif passed > 0
                obj.dq = (q - obj.q) / passed;
            end
            lookahead = max(1, first - state.cycle);
            if ~isempty(obj.rows)
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
        end

        function [q, dq] = ahead(obj)
            q = obj.q;
            dq = obj.dq;
            if isempty(obj.rows), return, end
            undecided = find(isnan(obj.rows(:, 3)));
            undecided = undecided(max(1, end - obj.lookahead + 1):end);
            counted = obj.rows([find(~isnan(obj.rows(:, 3))); undecided], 4:end);
            if ~isempty(counted)
                q = q + sum(counted, 1)';
                dq = counted(end, :)';
            end
        end
    end

    methods (Access = private)
        function forget(obj, which)
            obj.given_up = obj.given_up + sum(which);
            obj.rows(which, :) = [];
        end
    end
end
