// MIT mode of the AK70-10 as bytes; the same numbers as hardware/protocol/ak70.py, rounded the same way.
#pragma once
#include "can_frame.h"

namespace aerodima {

constexpr int kLeastId = 1, kMostId = 0x3F;

// Ranges of one firmware of the motor. Each is to either side of zero, except the gains.
struct Profile {
  double position = 0, speed = 0, torque = 0, kp = 0, kd = 0;  // rad, rad/s, N m, N m/rad, N m s/rad
  int temperature_offset = 0;                                  // degrees Celsius
  bool short_replies = true, long_replies = true;              // 6 bytes, 8 bytes
};

struct MitCommand {
  double position = 0, velocity = 0, kp = 0, kd = 0, torque = 0;
};

struct MitReply {
  int motor_id = 0;
  double position = 0, velocity = 0, torque = 0;
  bool has_health = false;  // the long form
  int temperature = 0, fault = 0;
};

enum class Special : uint8_t { kEnter = 0xFC, kExit = 0xFD };

bool valid_id(int motor_id);

CanFrame make_special(int motor_id, Special special);
bool is_exit(const CanFrame& frame);

// False, and `frame` untouched: id not allowed, a value NaN or out of range, or the bytes of a special frame.
bool make_command(int motor_id, const MitCommand& command, const Profile& profile, CanFrame* frame);

// False for an extended id, a length that the profile does not have, or a frame that names another motor than its id.
bool decode_reply(const CanFrame& frame, const Profile& profile, MitReply* reply);

}  // namespace aerodima
