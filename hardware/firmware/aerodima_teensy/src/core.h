// The Teensy of the car without its pins: strings in and out, CAN frames in and out, pulses, and the watchdog.
//
// Neutral outputs hold at the start, and again when no valid string has come for `watchdog_ms`: throttle and servo idle
// and, when the Teensy owns the CAN bus, exit frames to both motors, a burst at once, some more, then reminders. That
// state ends only with a neutral string: both motors ordered to exit and the throttle idle. A string counts as valid
// when all of it can be obeyed; what cannot is counted and does not feed the watchdog.
//
// The same state follows when the car lies on its side, by its attitude or by its accelerometer, does not turn at full
// steering, or is to drive with an attitude that is not known, and, where the Teensy watches the bus of the computer's adapter, when the heartbeat on it stops while the motors are
// armed. The throttle is clipped and comes on at a limited rate; it goes back at once. The frames of the motors pass
// their last limits here (motor_guard.h).
//
// A bus that takes nothing must not keep old orders: a frame that has waited for `kMostWaitMs` is dropped, unless it is
// an exit frame. Frames leave in the order in which they were made.
//
// The caller passes the time, a millisecond counter that may wrap, and calls `step` about every millisecond.
#pragma once
#include "heartbeat.h"
#include "motor_guard.h"
#include "strings.h"

namespace aerodima {

struct Config {
  bool owns_can = true;      // wiring teensy_bridge; false: watched_can
  Profile profile;
  uint32_t watchdog_ms = 0;
  uint32_t exit_burst = 0;      // exit frames at once
  uint32_t exit_cycles = 0;     // further ones, one per exit_cycle_ms
  uint32_t exit_cycle_ms = 0;
  uint32_t reminder_ms = 0;     // interval of exit frames and of unasked replies after that
  uint32_t reply_wait_ms = 0;   // how long a reply waits for the motors
  int sail_bits = 0;
  int motor_ids[2] = {0, 0};    // switched off at the start; 0: unknown until the first string
  double attitude_limit = 0;    // rad, of roll and pitch
  uint32_t attitude_ms = 0;     // for how long beyond it
  uint32_t attitude_age_ms = 0; // oldest attitude with which the car drives
  int full_servo = 0, driving_throttle = 0;  // us from idle at which the car must turn
  double least_yaw_rate = 0;    // rad/s, of a car that turns
  uint32_t straight_ms = 0;     // for how long with less
  int throttle_least = kThrottle.least, throttle_most = kThrottle.most;  // us
  double throttle_start = 0;    // us from idle that come on at once
  double throttle_rate = 0;     // us per ms away from idle
  MotorLimits limits[2];
};

// For how long a condition has held, ms.
struct Debounce {
  bool holds = false;
  uint32_t since = 0;
  bool lasts(bool now_holds, uint32_t now, uint32_t limit) {
    if (now_holds && !holds) since = now;
    holds = now_holds;
    return holds && now - since >= limit;
  }
};

constexpr uint32_t kMostWaitMs = 15;  // 20 ms on the bus at the latest: the caller's loop and one frame come on top

class TeensyCore {
 public:
  TeensyCore(const Config& config, uint32_t now);

  void feed(const char* data, size_t size, uint32_t now);     // bytes from the computer
  void receive(const CanFrame& frame);                        // a frame from the bus
  void set_sail_word(uint32_t word) { sail_word_ = word; }
  void step(uint32_t now);

  bool next_frame(CanFrame* frame);                           // frames for the bus, oldest first, none that is stale
  bool is_stale(const CanFrame& frame) const;                 // must not reach the bus any more
  size_t take_reply(char* text, size_t size);                 // string for the computer; 0: none

  int servo() const { return servo_; }                        // us
  int throttle() const { return throttle_; }
  Status status() const { return latched_ ? cause_ : Status::kRunning; }
  uint32_t rejected() const { return reader_.rejected() + refused_; }

 private:
  void obey(const Command& command, uint32_t now);
  bool may_drive(const Command& command, uint32_t now);
  bool may_be_released() const;
  void look_at_beats(uint32_t now);
  void hear_beat(const CanFrame& frame);
  void move_throttle(uint32_t now);
  bool can_be_obeyed(const Command& command) const;
  void bridge(const Order& order, const MotorGuard& guard);
  void make_safe(uint32_t now, Status cause);
  void exit_motors(uint32_t repeats);
  void push(CanFrame frame);
  void drop_stale();
  bool knows_motors() const { return reports_[0].motor_id != 0; }
  bool motors_answered() const;
  void write_reply(uint32_t now);

  Config config_;
  CommandReader reader_;
  Report reports_[2];
  uint32_t unanswered_[2] = {0, 0};
  uint32_t sail_word_ = 0, refused_ = 0;
  int servo_ = kServo.idle, throttle_ = kThrottle.idle;
  bool latched_ = true;
  Status cause_ = Status::kWatchdogActed;
  uint32_t clock_ = 0;                     // of the last call that had a time
  Debounce tilted_, straight_;
  bool beats_armed_ = false, beat_heard_ = false;
  uint8_t beat_counter_ = 0;
  uint32_t beat_ = 0;                      // time of the last new heartbeat
  int throttle_target_ = kThrottle.idle;   // us
  double throttle_offset_ = 0;             // us from idle, as it is now
  uint32_t throttle_time_ = 0;
  MotorGuard guards_[2];
  uint32_t fresh_ = 0;                     // time of the last valid string
  uint32_t exit_time_ = 0, exits_left_ = 0;
  bool reply_pending_ = false;
  uint32_t reply_since_ = 0;

  static constexpr size_t kQueue = 64;
  CanFrame queue_[kQueue];
  size_t queue_begin_ = 0, queue_size_ = 0;
  char reply_[kLongestReply];
  size_t reply_size_ = 0;
};

}  // namespace aerodima
