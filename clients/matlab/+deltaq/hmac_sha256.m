function digits = hmac_sha256(key, text)
% HMAC-SHA256 (RFC 2104) of a text, in hexadecimal digits: it shows a token without sending it. MATLAB needs its Java.
    key = unicode2native(key, 'UTF-8');
    if numel(key) > 64, key = sha256(key); end
    block = zeros(1, 64, 'uint8');
    block(1:numel(key)) = key;
    inner = sha256([bitxor(block, uint8(54)), uint8(text)]);
    outer = sha256([bitxor(block, uint8(92)), inner]);
    digits = sprintf('%02x', outer);
end

function digest = sha256(bytes)
    if exist('OCTAVE_VERSION', 'builtin')
        digest = uint8(hex2dec(reshape(hash('sha256', char(bytes)), 2, [])'))';
    else
        algorithm = java.security.MessageDigest.getInstance('SHA-256');
        digest = typecast(algorithm.digest(typecast(bytes, 'int8')), 'uint8')';
    end
end
