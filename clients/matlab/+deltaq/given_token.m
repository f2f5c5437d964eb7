function token = given_token()
% The token in the file that the environment variable DELTAQ_CLIENT_TOKEN_FILE names, or in DELTAQ_CLIENT_TOKEN; '' if
% neither is set.
    file = getenv('DELTAQ_CLIENT_TOKEN_FILE');
    if isempty(file)
        token = getenv('DELTAQ_CLIENT_TOKEN');
        return
    end
    [opened, why] = fopen(file, 'r');
    if opened < 0
        error('deltaq:token', '%s', sprintf('DELTAQ_CLIENT_TOKEN_FILE: %s cannot be read: %s', file, why));
    end
    close_it = onCleanup(@() fclose(opened));
    token = strtrim(fread(opened, Inf, '*char')');
    if isempty(token)
        error('deltaq:token', '%s', sprintf('DELTAQ_CLIENT_TOKEN_FILE: %s holds no text', file));
    end
end
