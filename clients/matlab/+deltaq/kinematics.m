function place = kinematics(description, robot, frame)
% A function that places a frame of a robot: [T, J] = place(q).
%
%   camera = deltaq.kinematics(lab.describe(), 'fr', 'camera');
%   [T, J] = camera(state.q);
%
% T (4,4) maps the frame's coordinates into the world [m]. J (6,n) is the Jacobian of its origin in world axes: velocity
% [m/s] over angular velocity [rad/s] per unit of joint velocity. Frames are `tool`, `camera` if the robot has one, and
% its hands.
    name = matlab.lang.makeValidName(char(robot));
    if ~isfield(description.kinematics, name)
        error('deltaq:unknown_robot', '%s', sprintf('cell %s has no robot ''%s''; it has %s', ...
            description.cell, char(robot), strjoin(fieldnames(description.kinematics)', ', ')));
    end
    arm = description.kinematics.(name);
    if ~isfield(arm.frames, char(frame))
        error('deltaq:unknown_frame', '%s', sprintf('robot %s has no frame ''%s''; it has %s', ...
            char(robot), char(frame), strjoin(fieldnames(arm.frames)', ', ')));
    end
    carried = arm.frames.(char(frame));
    chain = struct('n', numel(arm.joints), 'joints', [], 'placed', {{}}, 'axes', [], 'across', {{}}, ...
        'turns', strcmp(description.robots.(name).units, 'rad'), 'last', carried.T_joint_frame);
    joint = carried.joint;
    while joint >= 0  % from the frame to the world
        told = arm.joints(joint + 1);
        a = told.axis;
        chain.joints = [joint + 1, chain.joints];
        chain.placed = [{told.T_parent_joint}, chain.placed];
        chain.axes = [a, chain.axes];
        chain.across = [{[0 -a(3) a(2); a(3) 0 -a(1); -a(2) a(1) 0]}, chain.across];
        joint = told.parent;
    end
    place = @(q) placed(chain, q);
end

function [T, J] = placed(chain, q)
    T = eye(4);
    count = numel(chain.joints);
    axes = zeros(3, count);
    origins = zeros(3, count);
    for index = 1:count
        joint = chain.joints(index);
        T = T * chain.placed{index};
        axes(:, index) = T(1:3, 1:3) * chain.axes(:, index);
        if chain.turns(joint)
            K = chain.across{index};
            T(1:3, 1:3) = T(1:3, 1:3) * (eye(3) + sin(q(joint)) * K + (1 - cos(q(joint))) * (K * K));
        else
            T(1:3, 4) = T(1:3, 4) + q(joint) * axes(:, index);
        end
        origins(:, index) = T(1:3, 4);
    end
    T = T * chain.last;
    J = zeros(6, chain.n);
    for index = 1:count
        joint = chain.joints(index);
        a = axes(:, index);
        if chain.turns(joint)
            r = T(1:3, 4) - origins(:, index);
            J(:, joint) = [a(2) * r(3) - a(3) * r(2); a(3) * r(1) - a(1) * r(3); a(1) * r(2) - a(2) * r(1); a];
        else
            J(1:3, joint) = a;
        end
    end
end
