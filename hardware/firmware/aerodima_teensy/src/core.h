// The Teensy of the car without its pins: strings in and out, CAN frames in and out, pulses, and the watchdog.
//
// Neutral outputs hold at the start, and again when no valid string has come for `watchdog_ms`: throttle and servo idle
// and, when the Teensy owns the CAN bus, exit frames to both motors, a burst at once, some more, then reminders. That
// state ends only with a neutral string: both motors ordered to exit and the throttle idle. A string counts as valid
// when all of it can be obeyed; what cannot is counted and does not feed the watchdog.
//
// The caller passes the time, a millisecond counter that may wrap, and calls `step` about every millisecond.
#pragma once
#include "strings.h"

namespace aerodima {

struct Config {
  bool owns_can = true;  // wiring teensy_bridge; false: direct_can
  bool checked = true;   // form of the strings
  Profile profile;
  uint32_t watchdog_ms = 0;
  uint32_t exit_burst = 0;      // exit frames at once
  uint32_t exit_cycles = 0;     // further ones, one per exit_cycle_ms
  uint32_t exit_cycle_ms = 0;
  uint32_t reminder_ms = 0;     // interval of exit frames and of unasked replies after that
  uint32_t reply_wait_ms = 0;   // how long a reply waits for the motors
  int sail_bits = 0;
  int motor_ids[2] = {0, 0};    // switched off at the start; 0: unknown until the first string
};

class TeensyCore {
 public:
  TeensyCore(const Config& config, uint32_t now);

  void feed(const char* data, size_t size, uint32_t now);     // bytes from the computer
  void receive(const CanFrame& frame);                        // a frame from the bus
  void set_sail_word(uint32_t word) { sail_word_ = word; }
  void step(uint32_t now);

  bool next_frame(CanFrame* frame);                           // frames for the bus, oldest first
  size_t take_reply(char* text, size_t size);                 // string for the computer; 0: none

  int servo() const { return servo_; }                        // us
  int throttle() const { return throttle_; }
  Status status() const { return latched_ ? Status::kWatchdogActed : Status::kRunning; }
  uint32_t rejected() const { return reader_.rejected() + refused_; }

 private:
  void obey(const Command& command, uint32_t now);
  bool can_be_obeyed(const Command& command) const;
  void bridge(const Order& order);
  void make_safe(uint32_t now);
  void exit_motors(uint32_t repeats);
  void push(const CanFrame& frame);
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
