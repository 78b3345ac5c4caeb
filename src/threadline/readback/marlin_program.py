"""The program that replaces all of Marlin but its planner; ``marlin_steps`` compiles it."""

MAIN = r"""
// In: words with their numbers ("steps", "rate", "most" for X Y Z I; "travel"; "least"; "short";
// "corner", which is the junction deviation or the jumps of X Y Z I; "go"), then one move a line:
// x y z i speed, whether all blocks end behind it, and the seconds that it waits there.
// Out: a block a line (its steps by axis, step events, speeds at the begin, at most and at the end,
// the steps where it stops to grow and begins to fall, acceleration, and how long it takes), a wait
// in a line of its own, and "end".
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "src/inc/MarlinConfig.h"
#include "src/module/motion.h"
#include "src/module/planner.h"
#include "src/module/stepper.h"
#include "src/module/temperature.h"

static block_t *under_way = nullptr;

bool Stepper::is_block_busy(const block_t * const block) { return block == under_way; }
void Stepper::enable_axis(const AxisEnum) {}
void HAL_timer_enable_interrupt(const uint8_t) {}
#if HAS_FAN
  uint8_t Temperature::fan_speed[FAN_COUNT];
#endif

// A trapezoid of speed: so many steps faster and faster, so many slower and slower.
static double lasts_s(const block_t &b) {
  const double gain = b.acceleration_steps_per_s2, count = b.step_event_count,
               first = b.initial_rate, last = b.final_rate, nominal = b.nominal_rate;
  // Numbers that have become negative are very great ones: there is one part only then.
  const double up = fmin(b.accelerate_before, count),
               down = count - fmax(fmin(b.decelerate_start, count), up);
  double top = first, time_s = 0.0;
  if (up > 0.0) {
    top = fmax(first, fmin(sqrt(first * first + 2.0 * gain * up), nominal));
    const double over = up - (top * top - first * first) / (2.0 * gain);
    time_s += (top - first) / gain + fmax(over, 0.0) / fmin(top, nominal);
  }
  if (count > up + down) {
    top = nominal;
    time_s += (count - up - down) / top;
  }
  if (down > 0.0 && top <= last) return time_s + down / last;
  const double end = fmax(sqrt(fmax(top * top - 2.0 * gain * down, 0.0)), last);
  if (down > 0.0) {
    const double left = down - (top * top - end * end) / (2.0 * gain);
    time_s += (top - end) / gain + fmax(left, 0.0) / end;
  }
  return time_s;
}

// A block comes to its end, and the next is under way at once.
static bool goes_on() {
  if (!under_way) under_way = planner.get_current_block();
  if (!under_way) return false;
  const block_t &b = *under_way;
  for (int axis = 0; axis < 4; ++axis)
    printf("%s%lu ", b.direction_bits[axis] ? "" : "-", (unsigned long)b.steps[axis]);
  printf("%lu %.9g %.9g %.9g %.9g %.9g %.9g %.9f\n", (unsigned long)b.step_event_count,
         (double)b.initial_rate, (double)b.nominal_rate, (double)b.final_rate,
         (double)b.accelerate_before, (double)b.decelerate_start,
         (double)b.acceleration_steps_per_s2, lasts_s(b));
  planner.release_current_block();
  under_way = nullptr;
  under_way = planner.get_current_block();
  return true;
}

// The planner is idle when there is no room: so there are always as many blocks as it can hold.
#if IDLE_ALONE  // before it became part of a class, in 2025
  void idle(const bool) { goes_on(); }
#else
  void Marlin::idle(const bool) { goes_on(); }
#endif

// A few blocks alone are held back for a while.
static void to_its_end() {
  for (int waits = 0; planner.has_blocks_queued() && waits < 1000;)
    waits = goes_on() ? 0 : waits + 1;
}

static double number() {
  double value;
  if (scanf("%lf", &value) != 1) exit(2);
  return value;
}

template <typename T> static void four(T &to) {
  for (int axis = 0; axis < 4; ++axis) to[axis] = number();
}

int main() {
  auto &settings = planner.settings;
  memset(&settings, 0, sizeof settings);
  settings.min_segment_time_us = DEFAULT_MINSEGMENTTIME;
  char word[16];
  while (scanf("%15s", word) == 1 && strcmp(word, "go")) {
    if (!strcmp(word, "steps")) four(settings.axis_steps_per_mm);
    else if (!strcmp(word, "rate")) four(settings.max_feedrate_mm_s);
    else if (!strcmp(word, "most")) four(settings.max_acceleration_mm_per_s2);
    else if (!strcmp(word, "travel")) settings.travel_acceleration = number();
    else if (!strcmp(word, "least")) settings.min_travel_feedrate_mm_s = number();
    else if (!strcmp(word, "short")) settings.min_segment_time_us = number();
    else if (!strcmp(word, "corner")) {
      #if HAS_JUNCTION_DEVIATION
        planner.junction_deviation_mm = number();
      #else
        four(planner.max_jerk);
      #endif
    }
    else return 2;
  }
  planner.init();
  for (int axis = 0; axis < 4; ++axis)
    planner.mm_per_step[axis] = 1.0f / settings.axis_steps_per_mm[axis];
  planner.refresh_acceleration_rates();
  double x;
  while (scanf("%lf", &x) == 1) {
    xyze_pos_t to;
    to[0] = x;
    for (int axis = 1; axis < 4; ++axis) to[axis] = number();
    planner.buffer_line(to, number());
    const bool rests = number() > 0.0;
    const double wait_s = number();
    if (rests || wait_s > 0.0) to_its_end();
    if (wait_s > 0.0) printf("%.9g\n", wait_s);
  }
  to_its_end();
  printf("end\n");
  return 0;
}
"""
