// A JSON value, as much of it as a client of a cell needs.
#pragma once
#include <cmath>
#include <cstdio>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

namespace deltaq {

/// One value; true is the number 1, false 0. One that was never read is null.
struct Json {
  std::string text;
  double number = NAN;
  std::vector<Json> list;
  std::map<std::string, Json> fields;
  bool is_null = true;

  const Json& operator[](const std::string& name) const {
    const auto found = fields.find(name);
    if (found == fields.end()) throw std::runtime_error("malformed: a message without " + name);
    return found->second;
  }

  std::vector<double> numbers() const {
    std::vector<double> all;
    for (const Json& one : list) all.push_back(one.number);
    return all;
  }
};

/// The value at `at` of a text; `at` is left behind it.
inline Json parsed_at(const std::string& text, std::size_t& at) {
  const auto next = [&] {
    at = text.find_first_not_of(" \t\r\n,:", at);
    if (at == std::string::npos) throw std::runtime_error("malformed: a line ends too early");
    return text[at];
  };
  const auto is = [&](const char* word) {
    const std::string wanted = word;
    if (text.compare(at, wanted.size(), wanted) != 0) return false;
    at += wanted.size();
    return true;
  };
  Json value;
  value.is_null = next() == 'n';
  if (text[at] == '{') {
    for (++at; next() != '}';) {
      const std::string name = parsed_at(text, at).text;
      value.fields[name] = parsed_at(text, at);
    }
    ++at;
  } else if (text[at] == '[') {
    for (++at; next() != ']';) value.list.push_back(parsed_at(text, at));
    ++at;
  } else if (text[at] == '"') {
    for (++at; at < text.size() && text[at] != '"'; ++at) {
      if (text[at] == '\\') ++at;  // the next one as it is: control characters are for people only
      if (at < text.size()) value.text += text[at];
    }
    ++at;
  } else if (is("true")) {
    value.number = 1;
  } else if (is("false")) {
    value.number = 0;
  } else if (!is("null")) {
    std::size_t length = 0;
    value.number = std::stod(text.substr(at, 40), &length);
    at += length;
  }
  return value;
}

inline Json parsed(const std::string& text) {
  std::size_t at = 0;
  return parsed_at(text, at);
}

inline std::string quoted(const std::string& text) {
  std::string result = "\"";
  for (char one : text) result += one == '"' || one == '\\' ? std::string("\\") + one : std::string(1, one);
  return result + "\"";
}

inline std::string printed(double number) {
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.17g", number);
  return std::isfinite(number) ? digits : "null";
}

}  // namespace deltaq
