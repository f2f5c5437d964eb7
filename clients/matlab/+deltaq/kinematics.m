function place = kinematics(description, robot, frame)
% A function that places a frame of a robot: [T, J] = place(q).
%
%   camera = deltaq.kinematics(lab.describe(), 'fr', 'camera');
%   [T, J] = camera(state.q);
%
% T (4,4) maps the frame's coordinates into the world [m]. J (6,n) is the Jacobian of its origin in world axes: velocity
% [m/s] over angular velocity [rad/s] per unit of joint velocity. Frames are `tool`, `camera` if the robot has one, and
% its hands.
    if ~isfield(description, 'kinematics') || isempty(fieldnames(description.kinematics))
        error('deltaq:no_kinematics', '%s', sprintf( ...
            'the server of cell %s tells no kinematics: it is older than this client', description.cell));
    end
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
    joints = [];  % those that carry the frame, from the world on
    joint = carried.joint + 1;
    while joint > 0
        joints = [joint, joints];  %#ok<AGROW>
        joint = arm.joints(joint).parent + 1;
    end
    chain = struct('n', numel(arm.joints), 'joints', joints, 'last', carried.T_joint_frame, 'rotations', {{}}, ...
        'offsets', {{}}, 'axes', {{}}, 'across', {{}}, 'twice_across', {{}});
    chain.turns = reshape(strcmp(description.robots.(name).units(joints), 'rad'), 1, []);
    for index = 1:numel(joints)
        told = arm.joints(joints(index));
        a = told.axis;
        chain.rotations{index} = told.T_parent_joint(1:3, 1:3);
        chain.offsets{index} = told.T_parent_joint(1:3, 4);
        chain.axes{index} = a;
        chain.across{index} = [0 -a(3) a(2); a(3) 0 -a(1); -a(2) a(1) 0];
        chain.twice_across{index} = chain.across{index} ^ 2;
    end
    place = @(q) placed(chain, q);
end

function [T, J] = placed(chain, q)
    joints = chain.joints;
    turns = chain.turns;
    rotations = chain.rotations;
    offsets = chain.offsets;
    told_axes = chain.axes;
    across = chain.across;
    twice_across = chain.twice_across;
    count = numel(joints);
    q = q(joints);
    s = sin(q);
    c = 1 - cos(q);
    R = eye(3);
    x = zeros(3, 1);
    axes = zeros(3, count);
    origins = zeros(3, count);
    for index = 1:count
        x = x + R * offsets{index};
        R = R * rotations{index};
        axis = R * told_axes{index};
        axes(:, index) = axis;
        if turns(index)
            origins(:, index) = x;
            R = R + R * (s(index) * across{index} + c(index) * twice_across{index});  % Rodrigues
        else
            x = x + q(index) * axis;
        end
    end
    T = [R, x; 0 0 0 1] * chain.last;
    r = T(1:3, 4) - origins;
    a = axes .* turns;
    J = zeros(6, chain.n);
    J(:, joints) = [a([2 3 1], :) .* r([3 1 2], :) - a([3 1 2], :) .* r([2 3 1], :) + axes .* ~turns; a];
end
