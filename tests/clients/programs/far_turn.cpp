// Turns A1 by an angle [rad] from farther away than a cycle, and tells how many cycles its answers waited.
#include <iostream>

#include "deltaq.hpp"

constexpr int settled = 20;  // states: longer than anything that was given up for lost can still be on its way

int main(int, char** given) try {
  deltaq::Client lab(given[1], given[2]);
  lab.acquire("fr", true);
  const double step = std::acos(-1.0) / 6 * lab.welcome["cycle_s"].number;
  deltaq::Json state = lab.next_state();
  const double target = state["q_cmd"].numbers()[0] + std::stod(given[3]);
  double delay = 0;
  for (int there = 0; there <= settled; state = lab.next_state()) {
    there = std::abs(target - state["q_cmd"].numbers()[0]) < 1e-3 ? there + 1 : 0;
    delay = std::max(delay, state["playout"]["delay_cycles"].number);
    for (double cycle : lab.cycles_to_answer()) {
      const double left = target - lab.ahead()[0];
      lab.send({std::max(-step, std::min(step, 0.2 * left)), 0, 0, 0, 0, 0}, cycle);
    }
  }
  std::cout << "delay " << delay << "\n";
} catch (const std::exception& error) {
  std::cerr << error.what() << "\n";
  return 1;
}
