#include "motor_guard.h"

#include <math.h>

namespace aerodima {
namespace {

constexpr double kBeyond = 0.3;  // rad, out of the range: a zero that is wrong; no torque leads back from there
constexpr double kFade = 0.2;  // share of the budget over which the torque is taken back

double clip(double value, double limit) { return smaller(larger(value, -limit), limit); }

}  // namespace

void MotorGuard::take(const MitReply& reply, uint32_t now) {
  const double seconds = known_ ? (now - time_) / 1000.0 : 0.0;
  const double rated = limits_.rated_torque;
  load_ = larger(0.0, load_ + (reply.torque * reply.torque - rated * rated) * seconds);
  known_ = true;
  time_ = now;
  position_ = reply.position;
  speed_ = reply.velocity;
}

double MotorGuard::allowed_torque() const {
  const double share = smaller(1.0, larger(0.0, (limits_.budget - load_) / (kFade * limits_.budget)));
  const double rated = smaller(limits_.rated_torque, limits_.torque);
  return rated + share * (limits_.torque - rated);
}

MitCommand MotorGuard::limit(const MitCommand& command) const {
  MitCommand c;
  c.position = smaller(larger(command.position, limits_.low), limits_.high);
  if (!known_ || position_ < limits_.low - kBeyond || position_ > limits_.high + kBeyond) return c;
  const double most = allowed_torque();
  c.velocity = clip(command.velocity, limits_.speed);
  c.torque = clip(command.torque, most);
  if (position_ >= limits_.high) {
    c.velocity = smaller(c.velocity, 0.0);
    c.torque = smaller(c.torque, 0.0);
  } else if (position_ <= limits_.low) {
    c.velocity = larger(c.velocity, 0.0);
    c.torque = larger(c.torque, 0.0);
  }
  c.kp = smaller(command.kp, limits_.kp);
  c.kd = smaller(command.kd, limits_.kd);
  const double total = fabs(c.kp * (c.position - position_) + c.kd * (c.velocity - speed_) + c.torque);
  if (total > most) {
    const double factor = most / total;
    c.kp *= factor;
    c.kd *= factor;
    c.torque *= factor;
  }
  return c;
}

}  // namespace aerodima
