// The token that the environment gives a client.
#pragma once
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <string>

namespace deltaq {
/// The token in the file that DELTAQ_CLIENT_TOKEN_FILE names, or in DELTAQ_CLIENT_TOKEN; empty if neither is set.
inline std::string given_token() {
  const char *file = std::getenv("DELTAQ_CLIENT_TOKEN_FILE"), *token = std::getenv("DELTAQ_CLIENT_TOKEN");
  if (!file || !*file) return token ? token : "";
  const std::string named = std::string("DELTAQ_CLIENT_TOKEN_FILE: ") + file;
  std::ifstream opened(file);
  std::string text;
  std::getline(opened, text, '\0');
  if (!opened.is_open() || opened.bad()) throw std::runtime_error(named + " cannot be read: " + std::strerror(errno));
  const char* blanks = " \t\r\n";
  const auto begin = text.find_first_not_of(blanks);
  if (begin == std::string::npos) throw std::runtime_error(named + " holds no text");
  return text.substr(begin, text.find_last_not_of(blanks) + 1 - begin);
}
}  // namespace deltaq
