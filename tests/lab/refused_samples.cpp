// Ticks that are refused keep the state and clear the answer; used by test_export.py.
#include <cstdio>
#include "knee_contact.h"
extern "C" const knee_contact_knee healthy;
int main() {
  knee_contact_state state{};
  knee_contact_answer answer;
  knee_contact_tick(&healthy, &state, 0.0, 0.3, 700.0, &answer);
  const knee_contact_state before = state;
  const double bad[][3] = {{0, .3, 700}, {-1e-3, .3, 700}, {NAN, .3, 700}, {INFINITY, .3, 700},
                           {1e-3, NAN, 700}, {1e-3, 17, 700}, {1e-3, .3, INFINITY}, {1e-3, .3, 2e6}};
  int refused = 0, kept = 1, cleared = 1;
  for (const auto &one : bad) {
    memset(&answer, 0xA5, sizeof answer);
    refused += knee_contact_tick(&healthy, &state, one[0], one[1], one[2], &answer) == KNEE_CONTACT_REFUSED;
    kept &= memcmp(&state, &before, sizeof state) == 0;
    cleared &= answer.contact_force == 0.0 && answer.stamp == 0 && (answer.status & KNEE_CONTACT_UNUSABLE) != 0;
  }
  memset(&answer, 0xA5, sizeof answer);
  const int then = knee_contact_tick(&healthy, &state, 1e-3, 0.3, 700.0, &answer);
  cleared &= answer.contact_point_z == 0.0 && answer.latency == 0.0 && answer.contact_wrench_torque_x == 0.0;
  std::printf("refused %d of 8, %s, %s; then %d\n", refused, kept ? "state kept" : "state changed",
              cleared ? "answers cleared" : "old numbers left", then);
}
