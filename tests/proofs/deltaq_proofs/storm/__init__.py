"""A storm on RSI's wire: real Robot Server and emulated KRC, an attacker beside them, and a witness of every reply."""
