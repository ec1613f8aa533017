// Strings between the computer and the Teensy; hardware/protocol/teensy.py has the other end of them.
#pragma once
#include <stddef.h>

#include "ak70.h"

namespace aerodima {

struct Pulses {
  int least, idle, most;  // us
};
constexpr Pulses kServo{950, 1500, 2050}, kThrottle{1100, 1500, 1900};  // thesis 5.4.5

enum class Request { kExit = 0, kEnter = 1, kCommand = 2 };
enum class Status { kRunning = 0, kWatchdogActed = 1, kAttitude = 2, kBeatsStopped = 3 };

struct Order {
  int motor_id = 0;
  Request request = Request::kExit;
  MitCommand command;
};

// How the car stands and turns, as the computer's IMU has it.
struct Attitude {
  double roll = 0, pitch = 0;  // rad
  int age = 0;                 // ms
  double lean = 0;             // rad from upright, by the accelerometer
  double yaw_rate = 0;         // rad/s
  bool known() const { return age != kUnknownAge; }
  static constexpr int kUnknownAge = 65535;
};

struct Command {
  Order orders[2];
  int servo = kServo.idle, throttle = kThrottle.idle;  // us
  Attitude attitude{0, 0, Attitude::kUnknownAge, 0, 0};
};

struct Report {
  int motor_id = 0;
  double position = 0, velocity = 0, torque = 0;
  int replies = 0, temperature = 0, fault = kUnknownFault;
  static constexpr int kUnknownFault = -1;  // the motor's replies carry neither temperature nor fault
};

struct Reply {
  Report reports[2];
  double sail = 0;  // degrees
  uint32_t clock = 0;  // ms
  Status status = Status::kRunning;
};

constexpr size_t kLongestPart = 200;  // bytes between two '|'; more is noise
constexpr size_t kLongestCommand = 3 * (kLongestPart + 1);
constexpr size_t kLongestReply = 400;

uint8_t crc8(const char* data, size_t size);

// A whole string with its last '|'. False for anything that is not a valid command; `command` is untouched then.
bool decode_command(const char* text, size_t size, Command* command);

// Writes the string and returns its length; 0 if a value is not finite, an id is not allowed or `size` is too small.
size_t make_reply(const Reply& reply, char* text, size_t size);

// Commands out of a stream that begins anywhere, is cut anywhere and may carry noise.
class CommandReader {
 public:
  // Takes one byte; true when `command` was filled by the string that it completed.
  bool feed(char byte, Command* command);

  uint32_t rejected() const { return rejected_; }

 private:
  bool take(Command* command);

  bool synchronised_ = false;
  char text_[kLongestCommand + kLongestPart + 1];  // complete parts that wait, then the open one
  size_t ends_[3] = {};                            // end of each waiting part, behind its '|'
  int waiting_ = 0;
  size_t open_ = 0;  // bytes of the open part
  uint32_t rejected_ = 0;
};

}  // namespace aerodima
