// Turn A1 of the floor robot by 10 degrees at 30 degrees/s: g++ -std=c++17 -o turn_a1 turn_a1.cpp && ./turn_a1 [HOST [PORT]]
#include <algorithm>
#include <iostream>

#include "deltaq.hpp"

int main(int count, char** given) try {
  const double pi = std::acos(-1.0);
  deltaq::Client lab(count > 1 ? given[1] : "127.0.0.1", count > 2 ? given[2] : "5210", "turn-a1");
  lab.acquire("fr");
  const double step = pi / 6 * lab.welcome["cycle_s"].number;  // [rad] in one cycle
  double target = NAN, left = NAN;
  long seq = 0;
  for (;;) {
    const deltaq::Json state = lab.next_state();
    if (state["phase"].text == "held")
      throw std::runtime_error("fr is held: " + state["reason"].text + "; when it is safe, `deltaq reset --robot fr`");
    std::vector<double> q = state[state["q_ahead"].is_null ? "q_cmd" : "q_ahead"].numbers();
    if (std::isnan(target)) target = q[0] + pi / 18;
    left = target - q[0];
    if (std::abs(left) < 1e-3) break;
    std::vector<double> dq(q.size(), 0.0);
    dq[0] = std::clamp(0.2 * left, -step, step);
    seq = lab.send(dq);
    for (const deltaq::Json& verdict : lab.new_verdicts())
      if (verdict["outcome"].text != "admitted")
        for (const deltaq::Json& reason : verdict["reasons"].list)
          std::cout << verdict["outcome"].text << " " << reason["code"].text << "\n";
  }
  std::printf("A1 is at %.2f deg after %ld increments\n", (target - left) * 180 / pi, seq);
} catch (const std::exception& error) {
  std::cerr << error.what() << "\n";
  return 1;
}
