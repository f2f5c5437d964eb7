// A client of a running cell for C++17 and POSIX sockets: lines of JSON over TCP, and no dependencies.
//
//   deltaq::Client lab("127.0.0.1", "5210");
//   lab.acquire("fr");
//   for (;;) { lab.next_state(); lab.send({5e-4, 0, 0, 0, 0, 0}); }  // rad in one cycle
//
// `deltaq schema` prints the fields of all messages. No verdict is waited for: new_verdicts() returns what has come.
// What is refused is a std::runtime_error. The destructor gives the lease back.
#pragma once
#include <chrono>
#include <optional>
#include <utility>
#include "given_token.hpp"
#include "hmac_sha256.hpp"
#include "in_flight.hpp"
#include "json.hpp"
#include "lines.hpp"

namespace deltaq {
class Client {
 public:
  Json welcome;  // the cycle, and names, units and limits by robot

  /// Connect; the token is needed where the cell asks for one, and is by default that of the environment.
  Client(const std::string& host, const std::string& port, const std::string& name = "c++",
         const std::string& token = given_token()) : lines_(host, port) {
    std::string proof;  // the token is shown and not sent: somebody else may listen at this port
    if (!token.empty()) {
      const std::string challenge = ask("\"challenge\"", "challenge")["challenge"].text;
      proof = ",\"challenge\":" + quoted(challenge) + ",\"proof\":" + quoted(hmac_sha256(token, "deltaq hello " + challenge));
    }
    welcome = ask("\"hello\",\"protocol\":3,\"client\":" + quoted(name) + proof, "welcome");
  }
  ~Client() {
    try { release(); } catch (const std::runtime_error&) {}  // the server has gone: the robot comes to rest by itself
  }
  /// Take the lease of a robot. next_state() and send() renew it; whoever computes for longer calls renew() meanwhile.
  /// With a jitter buffer from farther away than a cycle; then use ahead() and cycles_to_answer().
  void acquire(const std::string& robot, bool playout = false) {
    std::string has = "unknown_robot: cell " + welcome["cell"].text + " has no robot '" + robot + "'; it has";
    for (const auto& one : welcome["robots"].fields) has += " " + one.first;
    if (!welcome["robots"].fields.count(robot)) throw std::runtime_error(has);
    const Json answer = ask(lease(robot, "acquire") + (playout ? ",\"playout\":true" : ""), "lease"), &code = answer["code"], &holder = answer["holder"];
    const std::string why = holder.is_null ? " needs a controller's token" : " is held by " + holder.text;
    if (!code.is_null) throw std::runtime_error(code.text + ": the lease of " + robot + why);
    robot_ = robot, lease_s_ = answer["expires_s"].number;
    in_flight_.reset();
    if (playout) in_flight_.emplace();
  }
  /// The newest state of the leased robot, once there is a newer one than last time.
  Json next_state() {
    for (read(false); !is_due(); read(true)) renew_in_time();
    renew_in_time();
    seen_cycle_ = newest()["cycle"].number;
    if (in_flight_) in_flight_->take_state(newest());
    return newest();
  }
  /// With a jitter buffer: the setpoint (n) that the next increment is added to [rad or m].
  std::vector<double> ahead() const { return in_flight_.value().ahead(); }
  /// With a jitter buffer: the cycles for which to send now.
  std::vector<double> cycles_to_answer() const { return in_flight_.value().cycles_to_answer(); }
  /// Ask for an increment [rad or m] in answer to the newest state that has come, however long it was computed.
  long send(const std::vector<double>& dq) {
    read(false);
    return send(dq, newest()["cycle"].number);
  }
  /// The same in answer to the state of a cycle.
  long send(const std::vector<double>& dq, double answered) {
    std::string list, cycle = printed(answered);
    for (double number : dq) list += (list.empty() ? "" : ",") + printed(number);
    const std::string seq = std::to_string(++seq_);
    say("\"increment\",\"robot\":" + quoted(robot_) + ",\"seq\":" + seq + ",\"cycle\":" + cycle + ",\"dq\":[" + list + "]");
    if (in_flight_) in_flight_->sent(seq_, answered, dq);
    return seq_;
  }
  /// Verdicts since the last call.
  std::vector<Json> new_verdicts() { return std::exchange(verdicts_, {}); }
  void renew() { say(lease(robot_, "renew")); }
  /// Give the lease back, and read the answer: whoever closes before looks like a controller that was lost.
  void release() {
    const std::string robot = std::exchange(robot_, "");
    if (robot.empty()) return;
    for (Json answer = ask(lease(robot, "release"), "lease"); !answer["holder"].is_null;) answer = awaited("lease");
  }

 private:
  Lines lines_;
  std::string robot_;
  std::map<std::string, Json> newest_, answers_;
  std::vector<Json> verdicts_;
  long seq_ = 0;
  double seen_cycle_ = -1, lease_s_ = 1;
  std::chrono::steady_clock::time_point said_;
  std::optional<InFlight> in_flight_;
  bool is_due() {
    if (newest().is_null || newest()["cycle"].number == seen_cycle_) return false;
    return !in_flight_ || !newest()["playout"].is_null;  // the first states of a lease may be of before it
  }
  const Json& newest() { return newest_.emplace(robot_, Json{}).first->second; }
  static std::string lease(const std::string& robot, const std::string& action) {
    return "\"lease\",\"robot\":" + quoted(robot) + ",\"action\":" + quoted(action);
  }
  void say(const std::string& rest) { lines_.say("{\"type\":" + rest + "}"), said_ = std::chrono::steady_clock::now(); }
  void renew_in_time() {
    if (std::chrono::duration<double>(std::chrono::steady_clock::now() - said_).count() > 0.3 * lease_s_) renew();
  }
  Json ask(const std::string& request, const std::string& type) { return answers_.erase(type), say(request), awaited(type); }
  Json awaited(const std::string& type) {
    while (!answers_.count(type)) read(true);
    return answers_.extract(type).mapped();
  }
  void read(bool wait) {
    for (const std::string& line : lines_.take(wait)) {
      const Json message = parsed(line), &type = message["type"];
      if (type.text == "state") newest_[message["robot"].text] = message;
      else if (type.text == "verdict") {
        verdicts_.push_back(message);
        if (in_flight_) in_flight_->take_verdict(message);
      }
      else answers_[type.text] = message;
    }
    if (!answers_.count("error")) return;  // told once every line has been read
    const Json error = answers_.extract("error").mapped();
    throw std::runtime_error(error["code"].text + ": " + error["message"].text + "; " + error["hint"].text);
  }
};
}  // namespace deltaq
