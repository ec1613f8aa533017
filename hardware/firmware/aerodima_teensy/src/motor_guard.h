// The last stage before a motor's frame: range, speed, gains, total torque and an I2t model of the winding; the same
// numbers as hardware/devices/motor_settings.py, in the motor's own angle.
#pragma once
#include "ak70.h"

namespace aerodima {

struct MotorLimits {
  double low = 0, high = 0;             // rad
  double speed = 0;                     // rad/s, commanded
  double torque = 0, kp = 0, kd = 0;    // most, N m, N m/rad, N m s/rad; torque of the whole loop
  double rated_torque = 0, budget = 0;  // N m for ever; (N m)^2 s beyond that
};

class MotorGuard {
 public:
  explicit MotorGuard(const MotorLimits& limits) : limits_(limits) {}

  // A reply that came at `now` (ms, may wrap).
  void take(const MitReply& reply, uint32_t now);

  // What is left of a command; without a reply yet, or far beyond the range, it makes no torque.
  MitCommand limit(const MitCommand& command) const;

  double allowed_torque() const;                       // N m, falls to the rated one over the last fifth of the budget

 private:
  MotorLimits limits_;
  bool known_ = false;
  double position_ = 0, speed_ = 0, load_ = 0;
  uint32_t time_ = 0;
};

}  // namespace aerodima
