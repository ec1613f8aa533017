#include "ak70.h"

#include <math.h>
#include <string.h>

namespace aerodima {
namespace {

constexpr int kPositionSteps = (1 << 16) - 1, kSteps = (1 << 12) - 1;

bool encode(double value, double low, double high, int steps, uint64_t* word) {
  if (!(low <= value && value <= high)) return false;  // also catches NaN
  *word = static_cast<uint64_t>(floor((value - low) * steps / (high - low) + 0.5));
  return true;
}

double decode(uint64_t word, double limit, int steps) { return -limit + static_cast<double>(word) * (2 * limit) / steps; }

}  // namespace

bool valid_id(int motor_id) { return kLeastId <= motor_id && motor_id <= kMostId; }

CanFrame make_special(int motor_id, Special special) {
  CanFrame frame;
  frame.id = static_cast<uint32_t>(motor_id);
  frame.length = 8;
  memset(frame.data, 0xFF, 7);
  frame.data[7] = static_cast<uint8_t>(special);
  return frame;
}

bool is_exit(const CanFrame& frame) {
  const CanFrame exit = make_special(static_cast<int>(frame.id), Special::kExit);
  return !frame.extended && frame.length == exit.length && !memcmp(frame.data, exit.data, sizeof exit.data);
}

bool make_command(int motor_id, const MitCommand& command, const Profile& profile, CanFrame* frame) {
  uint64_t position, velocity, kp, kd, torque;
  if (!valid_id(motor_id) || !encode(command.position, -profile.position, profile.position, kPositionSteps, &position) ||
      !encode(command.velocity, -profile.speed, profile.speed, kSteps, &velocity) ||
      !encode(command.kp, 0, profile.kp, kSteps, &kp) || !encode(command.kd, 0, profile.kd, kSteps, &kd) ||
      !encode(command.torque, -profile.torque, profile.torque, kSteps, &torque)) {
    return false;
  }
  const uint64_t bits = position << 48 | velocity << 36 | kp << 24 | kd << 12 | torque;
  if (bits >> 8 == 0x00FFFFFFFFFFFFFFull) return false;  // seven FF: a special frame
  frame->id = static_cast<uint32_t>(motor_id);
  frame->extended = false;
  frame->length = 8;
  for (int i = 0; i < 8; ++i) frame->data[i] = static_cast<uint8_t>(bits >> (56 - 8 * i));
  return true;
}

bool decode_reply(const CanFrame& frame, const Profile& profile, MitReply* reply) {
  const bool long_form = frame.length == 8;
  if (frame.extended || (long_form ? !profile.long_replies : frame.length != 6 || !profile.short_replies)) return false;
  const int motor_id = frame.data[0];
  if (!valid_id(motor_id) || (frame.id != 0 && frame.id != static_cast<uint32_t>(motor_id))) return false;
  uint64_t bits = 0;
  for (int i = 1; i < 6; ++i) bits = bits << 8 | frame.data[i];
  reply->motor_id = motor_id;
  reply->position = decode(bits >> 24, profile.position, kPositionSteps);
  reply->velocity = decode(bits >> 12 & kSteps, profile.speed, kSteps);
  reply->torque = decode(bits & kSteps, profile.torque, kSteps);
  reply->has_health = long_form;
  reply->temperature = long_form ? frame.data[6] - profile.temperature_offset : 0;
  reply->fault = long_form ? frame.data[7] : 0;
  return true;
}

}  // namespace aerodima
