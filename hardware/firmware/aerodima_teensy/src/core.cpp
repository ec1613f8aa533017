#include "core.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

namespace aerodima {
namespace {

constexpr uint32_t kMostSpanMs = 20;  // a loop that stood still does not catch up with a step of the throttle

bool is_neutral(const Command& command) {
  return command.orders[0].request == Request::kExit && command.orders[1].request == Request::kExit &&
         command.throttle == kThrottle.idle;
}

}  // namespace

TeensyCore::TeensyCore(const Config& config, uint32_t now)
    : config_(config),
      clock_(now),
      throttle_time_(now),
      guards_{MotorGuard(config.limits[0]), MotorGuard(config.limits[1])},
      fresh_(now) {
  if (valid_id(config.motor_ids[0]) && valid_id(config.motor_ids[1])) {
    reports_[0].motor_id = config.motor_ids[0];
    reports_[1].motor_id = config.motor_ids[1];
  }
  make_safe(now, Status::kWatchdogActed);
}

void TeensyCore::feed(const char* data, size_t size, uint32_t now) {
  clock_ = now;
  Command command;
  for (size_t i = 0; i < size; ++i) {
    if (!reader_.feed(data[i], &command)) continue;
    if (can_be_obeyed(command)) {
      obey(command, now);
    } else {
      ++refused_;
    }
  }
}

// Other motors than before are a new session, which must begin neutral; a frame must exist for every command.
bool TeensyCore::can_be_obeyed(const Command& command) const {
  const bool same = command.orders[0].motor_id == reports_[0].motor_id && command.orders[1].motor_id == reports_[1].motor_id;
  if (!is_neutral(command) && !same) return false;
  for (const Order& order : command.orders) {
    CanFrame frame;
    if (order.request == Request::kCommand && !make_command(order.motor_id, order.command, config_.profile, &frame)) {
      return false;
    }
  }
  return true;
}

void TeensyCore::obey(const Command& command, uint32_t now) {
  fresh_ = now;
  for (int i = 0; i < 2; ++i) {
    if (reports_[i].motor_id == command.orders[i].motor_id) continue;
    if (config_.owns_can && valid_id(reports_[i].motor_id)) push(make_special(reports_[i].motor_id, Special::kExit));
    reports_[i] = Report();
    reports_[i].motor_id = command.orders[i].motor_id;
    unanswered_[i] = 0;
    guards_[i] = MotorGuard(config_.limits[i]);
  }
  if (is_neutral(command) && may_be_released()) latched_ = false;
  if (!reply_pending_) {
    reply_pending_ = true;
    reply_since_ = now;
  }
  if (latched_) return;
  if (!may_drive(command, now)) {
    make_safe(now, Status::kAttitude);
    return;
  }
  servo_ = command.servo;
  throttle_target_ = smaller(larger(command.throttle, config_.throttle_least), config_.throttle_most);
  move_throttle(now);
  for (int i = 0; i < 2; ++i) bridge(command.orders[i], guards_[i]);
}

// The last attitude counts however old it is; to drive, it must be young as well. Without one the motors may be moved
// on a bench. A car that drives at full steering turns, or it lies and its attitude hangs.
bool TeensyCore::may_drive(const Command& command, uint32_t now) {
  const Attitude& a = command.attitude;
  const bool young = a.known() && static_cast<uint32_t>(a.age) <= config_.attitude_age_ms;
  if (!young && command.throttle != kThrottle.idle) return false;
  const bool tilted = a.known() && larger(larger(fabs(a.roll), fabs(a.pitch)), a.lean) > config_.attitude_limit;
  const bool to_turn = abs(command.servo - kServo.idle) >= config_.full_servo &&
                       abs(throttle_ - kThrottle.idle) >= config_.driving_throttle;
  const bool straight = to_turn && fabs(a.yaw_rate) < config_.least_yaw_rate;
  const bool fallen = tilted_.lasts(tilted, now, config_.attitude_ms);
  const bool at_rest = is_neutral(command) && !beats_armed_;
  return !(straight_.lasts(straight, now, config_.straight_ms) || fallen) || at_rest;
}

// After the heartbeat has stopped all exit frames go out first, and a computer that says armed is not at rest.
bool TeensyCore::may_be_released() const {
  return !beats_armed_ && (cause_ != Status::kBeatsStopped || exits_left_ == 0);
}

void TeensyCore::move_throttle(uint32_t now) {
  const double most = config_.throttle_rate * static_cast<double>(smaller(now - throttle_time_, kMostSpanMs));
  throttle_time_ = now;
  const double target = throttle_target_ - kThrottle.idle, side = target < 0 ? -1 : 1;
  const double begun = larger(0.0, side * throttle_offset_);
  const double reached = larger(begun + most, config_.throttle_start);
  throttle_offset_ = side * smaller(side * target, reached);
  throttle_ = kThrottle.idle + static_cast<int>(lround(throttle_offset_));
}

void TeensyCore::bridge(const Order& order, const MotorGuard& guard) {
  if (!config_.owns_can) return;
  CanFrame frame;
  const MitCommand command = guard.limit(order.command);
  switch (order.request) {
    case Request::kExit:
      push(make_special(order.motor_id, Special::kExit));
      return;
    case Request::kEnter:
      make_command(order.motor_id, MitCommand(), config_.profile, &frame);
      push(frame);
      push(make_special(order.motor_id, Special::kEnter));
      push(frame);
      return;
    case Request::kCommand:
      if (make_command(order.motor_id, command, config_.profile, &frame)) push(frame);
      return;
  }
}

void TeensyCore::receive(const CanFrame& frame) {
  if (!config_.owns_can) hear_beat(frame);
  MitReply reply;
  if (!config_.owns_can || !decode_reply(frame, config_.profile, &reply)) return;
  for (int i = 0; i < 2; ++i) {
    Report& report = reports_[i];
    if (report.motor_id != reply.motor_id) continue;
    report.position = reply.position;
    report.velocity = reply.velocity;
    report.torque = reply.torque;
    report.temperature = reply.temperature;
    report.fault = reply.has_health ? reply.fault : Report::kUnknownFault;
    report.replies = (report.replies + 1) & 0xFF;
    if (unanswered_[i]) --unanswered_[i];
    guards_[i].take(reply, clock_);
  }
}

void TeensyCore::hear_beat(const CanFrame& frame) {
  Beat beat;
  if (!decode_beat(frame, &beat)) return;
  push(make_answer(static_cast<uint8_t>(status()), beat.counter));
  // Armed, it only counts upwards: one that repeats, or a recorded piece that does, is no life.
  const uint8_t ahead = static_cast<uint8_t>(beat.counter - beat_counter_);
  const bool late = beats_armed_ && beat.state != BeatState::kTrip && ahead > kMaxAhead;
  if (beat_heard_ && (ahead == 0 || late)) return;
  beat_heard_ = true;
  beat_counter_ = beat.counter;
  beat_ = clock_;
  beats_armed_ = beat.state == BeatState::kArmed;
  if (beat.state == BeatState::kTrip) make_safe(clock_, Status::kBeatsStopped);
}

void TeensyCore::look_at_beats(uint32_t now) {
  if (!beats_armed_ || now - beat_ <= config_.watchdog_ms) return;
  beats_armed_ = false;
  make_safe(now, Status::kBeatsStopped);
  write_reply(now);
}

void TeensyCore::step(uint32_t now) {
  clock_ = now;
  look_at_beats(now);
  move_throttle(now);
  if (!latched_ && now - fresh_ > config_.watchdog_ms) {
    make_safe(now, Status::kWatchdogActed);
    write_reply(now);
  }
  if (latched_ && knows_motors()) {
    const uint32_t interval = exits_left_ ? config_.exit_cycle_ms : config_.reminder_ms;
    if (now - exit_time_ >= interval) {
      exit_time_ = now;
      if (exits_left_) {
        --exits_left_;
      } else if (!reply_pending_) {
        write_reply(now);
      }
      exit_motors(1);
    }
  }
  if (reply_pending_ && (motors_answered() || now - reply_since_ >= config_.reply_wait_ms)) write_reply(now);
}

void TeensyCore::make_safe(uint32_t now, Status cause) {
  latched_ = true;
  cause_ = cause;
  servo_ = kServo.idle;
  throttle_ = throttle_target_ = kThrottle.idle;
  throttle_offset_ = 0;
  exit_time_ = now;
  exits_left_ = config_.exit_cycles;
  queue_size_ = 0;  // no command leaves after this
  unanswered_[0] = unanswered_[1] = 0;
  if (!knows_motors()) return;
  for (const Report& report : reports_) {  // a motor may jump to its last command when it is entered again
    CanFrame frame;
    if (make_command(report.motor_id, MitCommand(), config_.profile, &frame)) push(frame);
  }
  exit_motors(config_.exit_burst);
}

void TeensyCore::exit_motors(uint32_t repeats) {
  for (uint32_t i = 0; i < repeats; ++i) {
    for (const Report& report : reports_) push(make_special(report.motor_id, Special::kExit));
  }
}

bool TeensyCore::is_stale(const CanFrame& frame) const { return clock_ - frame.made > kMostWaitMs && !is_exit(frame); }

void TeensyCore::drop_stale() {
  size_t kept = 0;
  for (size_t i = 0; i < queue_size_; ++i) {
    const CanFrame& frame = queue_[(queue_begin_ + i) % kQueue];
    if (!is_stale(frame)) queue_[(queue_begin_ + kept++) % kQueue] = frame;
  }
  queue_size_ = kept;
}

// A full queue means a bus that takes nothing: the oldest frame gives way.
void TeensyCore::push(CanFrame frame) {
  frame.made = clock_;
  if (queue_size_ == kQueue) drop_stale();
  if (queue_size_ == kQueue) {
    queue_begin_ = (queue_begin_ + 1) % kQueue;
    --queue_size_;
  }
  queue_[(queue_begin_ + queue_size_++) % kQueue] = frame;
  for (int i = 0; i < 2; ++i) {
    if (static_cast<uint32_t>(reports_[i].motor_id) == frame.id) ++unanswered_[i];
  }
}

bool TeensyCore::next_frame(CanFrame* frame) {
  drop_stale();
  if (queue_size_ == 0) return false;
  *frame = queue_[queue_begin_];
  queue_begin_ = (queue_begin_ + 1) % kQueue;
  --queue_size_;
  return true;
}

bool TeensyCore::motors_answered() const { return !config_.owns_can || (!unanswered_[0] && !unanswered_[1]); }

void TeensyCore::write_reply(uint32_t now) {
  reply_pending_ = false;
  unanswered_[0] = unanswered_[1] = 0;
  Reply reply;
  reply.reports[0] = reports_[0];
  reply.reports[1] = reports_[1];
  reply.sail = sail_word_ * 360.0 / static_cast<double>(1u << config_.sail_bits);
  reply.clock = now;
  reply.status = status();
  reply_size_ = make_reply(reply, reply_, sizeof reply_);
}

size_t TeensyCore::take_reply(char* text, size_t size) {
  const size_t length = reply_size_ <= size ? reply_size_ : 0;
  memcpy(text, reply_, length);
  reply_size_ = 0;
  return length;
}

}  // namespace aerodima
