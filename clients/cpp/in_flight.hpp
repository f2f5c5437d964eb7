// Increments in flight: sent, and not yet visible in a state, with a jitter buffer.
//
// Arithmetic without a clock: states say which increments their setpoint has, so no verdict has to come.
#pragma once
#include <algorithm>
#include <list>
#include "json.hpp"

namespace deltaq {
class InFlight {
 public:
  /// An increment (n) was sent in answer to the state of a cycle [rad or m].
  void sent(long seq, double cycle, const std::vector<double>& dq) {
    answered_ = std::max(answered_, cycle);
    const bool is_finite = std::all_of(dq.begin(), dq.end(), [](double step) { return std::isfinite(step); });
    if (is_finite) sent_.push_back({seq, cycle, dq});  // others are refused
  }
  /// What was refused goes into nothing.
  void take_verdict(const Json& verdict) {
    const double seq = verdict["seq"].number;
    if (verdict["outcome"].text == "refused") sent_.remove_if([&](const Sent& one) { return one.seq == seq; });
  }
  /// A state has come, with a `playout`.
  void take_state(const Json& state) {
    const double cycle = state["cycle"].number;
    const std::string& phase = state["phase"].text;
    if (cycle < cycle_ || phase == "held" || phase == "offline") sent_.clear(), answered_ = -1;
    cycle_ = cycle, state_ = state;
    const Json &playout = state["playout"], &answered = playout["answered_cycle"];
    const double shown = answered.is_null ? -1 : answered.number;
    const double given_up = cycle - 2 * playout["delay_cycles"].number - kPatienceCycles;
    sent_.remove_if([&](const Sent& one) { return one.cycle <= std::max(shown, given_up); });
  }
  /// The setpoint (n) that the next increment is added to [rad or m], if all that was sent has its turn.
  std::vector<double> ahead() const {
    const Json &told = state_["q_ahead"], &owed = state_["playout"]["owed"];
    std::vector<double> q = (told.is_null ? state_["q_cmd"] : told).numbers();
    add(q, owed.numbers());
    for (const Sent& one : sent_) add(q, one.dq);
    return q;
  }
  /// The cycles for which to send now: that of the newest state, and of those before it that were missed.
  std::vector<double> cycles_to_answer() const {
    const double missed = answered_ < 0 ? 0 : std::max(0.0, cycle_ - answered_ - 1);
    std::vector<double> cycles;
    for (double k = std::min(kMostCycles, 1 + missed); k > 0; --k) cycles.push_back(cycle_ - k + 1);
    return cycles;
  }

 private:
  struct Sent {
    long seq;
    double cycle;
    std::vector<double> dq;
  };
  static constexpr double kMostCycles = 5;  // what is older comes too late for its turn
  static constexpr double kPatienceCycles = 4;
  std::list<Sent> sent_;
  Json state_;
  double cycle_ = -1, answered_ = -1;
  static void add(std::vector<double>& q, const std::vector<double>& dq) {
    for (std::size_t joint = 0; joint < std::min(q.size(), dq.size()); ++joint) q[joint] += dq[joint];
  }
};
}  // namespace deltaq
