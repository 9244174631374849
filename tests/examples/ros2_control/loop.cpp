// A loop at 1 kHz, as the controller manager of ros2_control runs it, with a stepping person: loop CYCLES.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include "knee_contact_controller.hpp"

extern "C" const knee_contact_knee healthy;

int main(int, char ** argv)
{
  using clock = std::chrono::steady_clock;
  const int cycles = std::atoi(argv[1]);
  knee_contact::KneeContactController controller;
  controller.on_init();
  controller.on_configure({});
  double angle = 0.0, force = 0.0;
  const auto wanted = controller.state_interface_configuration().names;
  controller.state_interfaces_.emplace_back("", wanted[0], &angle);
  controller.state_interfaces_.emplace_back("", wanted[1], &force);
  auto exported = controller.export_state_interfaces();
  controller.on_activate({});
  knee_contact_state state{};  // of the same knee, called without a controller
  int same = 0, unusable = 0;
  std::vector<double> took;
  took.reserve(cycles);
  auto due = clock::now();
  for (int i = 0; i < cycles; ++i) {
    std::this_thread::sleep_until(due += std::chrono::milliseconds(1));
    const double t = 1e-3 * i;
    angle = 0.5 + 0.45 * std::sin(6.28 * t);
    force = -2.0 * (650.0 + 600.0 * std::sin(12.57 * t));
    const auto begin = clock::now();
    controller.update({}, rclcpp::Duration(1e-3));
    took.push_back(std::chrono::duration<double, std::micro>(clock::now() - begin).count());
    knee_contact_answer answer{};
    knee_contact_tick(&healthy, &state, 1e-3, angle, -0.5 * force, &answer);
    same += *exported[0].get_optional() == answer.contact_force &&
            *exported[1].get_optional() == answer.penetration_depth && *exported[2].get_optional() == answer.status;
    unusable += (static_cast<unsigned>(*exported[2].get_optional()) & KNEE_CONTACT_UNUSABLE) != 0;
  }
  force = NAN;
  controller.update({}, rclcpp::Duration(1e-3));
  const bool flagged = std::isnan(*exported[0].get_optional()) && *exported[2].get_optional() == KNEE_CONTACT_UNUSABLE;
  std::sort(took.begin(), took.end());
  std::printf("%s %s %s: %d of %d as the tick, %d unusable, bad force %s\n", exported[0].get_name().c_str(),
              exported[1].get_name().c_str(), exported[2].get_name().c_str(), same, cycles, unusable,
              flagged ? "flagged" : "missed");
  std::printf("a cycle: %.2f us (median), %.2f us (p99), %.1f us (max)\n", took[cycles / 2],
              took[cycles - 1 - cycles / 100], took.back());
}
