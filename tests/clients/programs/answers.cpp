// Answers so many states of a robot, each after computing for so long, and tells what became of it.
#include <iostream>

#include "deltaq.hpp"

int main(int, char** given) try {
  deltaq::Client lab(given[1], given[2]);
  lab.acquire(given[3]);
  std::string outcomes;
  for (int sent = 0; sent < std::stoi(given[5]); ++sent) {
    std::vector<double> dq(lab.next_state()["q_cmd"].list.size(), 0.0);
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(std::stod(given[4]));
    while (std::chrono::steady_clock::now() < end) continue;
    dq[0] = 1e-4;
    lab.send(dq);
    for (const deltaq::Json& verdict : lab.new_verdicts()) outcomes += " " + verdict["outcome"].text;
  }
  std::cout << "sent " << given[5] << ":" << outcomes << "\n";
} catch (const std::exception& error) {
  std::cerr << error.what() << "\n";
  return 1;
}
