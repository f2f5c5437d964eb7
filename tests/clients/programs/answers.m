function answers(host, port, robot, compute_s, count)
% Answers so many states of a robot, each after computing for so long, and tells what became of it.
    lab = deltaq.Client(host, port);
    finish = onCleanup(@() lab.close());
    lab.acquire(robot);
    outcomes = {};
    for index = 1:count
        q = lab.next_state().q_cmd;
        begin = tic();
        while toc(begin) < compute_s, end
        lab.send([1e-4, zeros(1, numel(q) - 1)]);
        outcomes = [outcomes, cellfun(@(verdict) verdict.outcome, lab.new_verdicts(), 'UniformOutput', false)];
    end
    fprintf('sent %d:%s\n', count, sprintf(' %s', outcomes{:}));
end
