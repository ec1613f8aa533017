#include "strings.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

namespace aerodima {
namespace {

constexpr size_t kMostDigits = 12;
constexpr double kMostAngle = 3.2;  // rad
constexpr double kMostRate = 40;    // rad/s

struct Text {
  const char* begin;
  const char* end;
  size_t size() const { return static_cast<size_t>(end - begin); }
};

Text strip(Text text, const char* characters) {
  while (text.begin < text.end && strchr(characters, *text.begin) && *text.begin) ++text.begin;
  while (text.begin < text.end && strchr(characters, text.end[-1]) && text.end[-1]) --text.end;
  return text;
}

const char* find(Text text, char wanted) {
  while (text.begin < text.end && *text.begin != wanted) ++text.begin;
  return text.begin;
}

// Takes the next field off `rest`; false when there is none left.
struct Fields {
  Text rest;
  bool done = false;

  bool next(Text* field) {
    if (done) return false;
    const char* end = find(rest, ';');
    *field = strip({rest.begin, end}, " ");
    done = end == rest.end;
    rest.begin = done ? end : end + 1;
    return true;
  }
};

bool digits(Text text) {
  if (text.begin == text.end) return false;
  for (const char* c = text.begin; c < text.end; ++c) {
    if (*c < '0' || *c > '9') return false;
  }
  return true;
}

bool read_integer(Text field, long low, long high, int* value) {
  Text number = field;
  if (field.size() && *field.begin == '-') ++number.begin;
  if (field.size() > kMostDigits || !digits(number)) return false;
  char copy[kMostDigits + 1] = {};
  memcpy(copy, field.begin, field.size());
  const long long read = strtoll(copy, nullptr, 10);
  if (read < low || read > high) return false;
  *value = static_cast<int>(read);
  return true;
}

bool read_number(Text field, double low, double high, double* value) {
  Text number = field;
  if (field.size() && (*field.begin == '-' || *field.begin == '+')) ++number.begin;
  const char* point = find(number, '.');
  const Text decimals{point == number.end ? point : point + 1, number.end};
  if (field.size() > kMostDigits || !digits({number.begin, point}) || (decimals.size() && !digits(decimals))) return false;
  char copy[kMostDigits + 1] = {};
  memcpy(copy, field.begin, field.size());
  const double read = strtod(copy, nullptr);
  if (!(low <= read && read <= high)) return false;
  *value = read;
  return true;
}

// Widest values that any firmware of the motor can carry; the profile's own range is checked before a frame is made.
bool read_order(Fields fields, Order* order) {
  Text field;
  int request;
  MitCommand& c = order->command;
  const struct {
    double* value;
    double low, high;
  } values[] = {{&c.position, -100, 100}, {&c.velocity, -200, 200}, {&c.kp, 0, 500}, {&c.kd, 0, 5}, {&c.torque, -200, 200}};
  if (!fields.next(&field) || !read_integer(field, 0, 255, &order->motor_id)) return false;
  if (!fields.next(&field) || !read_integer(field, 0, 2, &request)) return false;
  order->request = static_cast<Request>(request);
  for (const auto& value : values) {
    if (!fields.next(&field) || !read_number(field, value.low, value.high, value.value)) return false;
  }
  return fields.done;
}

bool read_pulse(Fields* fields, const Pulses& allowed, int* pulse) {
  Text field;
  return fields->next(&field) && read_integer(field, allowed.least, allowed.most, pulse);
}

// Behind the pulses.
bool read_attitude(Fields* fields, Attitude* attitude) {
  Text field;
  return fields->next(&field) && read_number(field, -kMostAngle, kMostAngle, &attitude->roll) && fields->next(&field) &&
         read_number(field, -kMostAngle, kMostAngle, &attitude->pitch) && fields->next(&field) &&
         read_integer(field, 0, Attitude::kUnknownAge, &attitude->age) && fields->next(&field) &&
         read_number(field, 0, kMostAngle, &attitude->lean) && fields->next(&field) &&
         read_number(field, -kMostRate, kMostRate, &attitude->yaw_rate);
}

// The second and third part begin with the ';' that follows the '|' before them.
bool begins_empty(Fields* fields) {
  Text field;
  return fields->next(&field) && field.size() == 0 && !fields->done;
}

bool open_string(const char* text, size_t size, Text* body) {
  if (size == 0 || text[size - 1] != '|') return false;
  *body = strip({text, text + size - 1}, " \r\n");
  const char* end = body->end;
  if (body->size() < 4 || end[-4] != ';' || end[-3] != '*') return false;
  char expected[3];
  snprintf(expected, sizeof expected, "%02X", crc8(body->begin, body->size() - 4));
  body->end = end - 4;
  return end[-2] == expected[0] && end[-1] == expected[1];
}

}  // namespace

uint8_t crc8(const char* data, size_t size) {
  uint8_t value = 0;  // polynomial x^8 + x^2 + x + 1, from 0
  for (size_t i = 0; i < size; ++i) {
    value ^= static_cast<uint8_t>(data[i]);
    for (int bit = 0; bit < 8; ++bit) value = static_cast<uint8_t>(value & 0x80 ? value << 1 ^ 0x07 : value << 1);
  }
  return value;
}

bool decode_command(const char* text, size_t size, Command* command) {
  Text body;
  if (!open_string(text, size, &body)) return false;
  const char* first = find(body, '|');
  if (first == body.end) return false;
  const char* second = find({first + 1, body.end}, '|');
  if (second == body.end || find({second + 1, body.end}, '|') != body.end) return false;
  Fields parts[3] = {{{body.begin, first}}, {{first + 1, second}}, {{second + 1, body.end}}};
  Command read;
  if (!read_order(parts[0], &read.orders[0]) || !begins_empty(&parts[1]) || !read_order(parts[1], &read.orders[1]) ||
      !begins_empty(&parts[2]) || !read_pulse(&parts[2], kServo, &read.servo) ||
      !read_pulse(&parts[2], kThrottle, &read.throttle) || !read_attitude(&parts[2], &read.attitude) ||
      !parts[2].done) {
    return false;
  }
  const int one = read.orders[0].motor_id, other = read.orders[1].motor_id;
  if (!valid_id(one) || !valid_id(other) || one == other) return false;
  *command = read;
  return true;
}

size_t make_reply(const Reply& reply, char* text, size_t size) {
  const Report &one = reply.reports[0], &other = reply.reports[1];
  if (!valid_id(one.motor_id) || !valid_id(other.motor_id) || one.motor_id == other.motor_id) return 0;
  const double values[] = {one.position, one.velocity, one.torque, other.position, other.velocity,
                           other.torque, reply.sail};
  for (double value : values) {
    if (!isfinite(value)) return 0;
  }
  int length = snprintf(text, size, "%d;%.5f;%.4f;%.4f;%d;%.5f;%.4f;%.4f;%.3f", one.motor_id, one.position,
                             one.velocity, one.torque, other.motor_id, other.position, other.velocity, other.torque,
                             reply.sail);
  size_t used = static_cast<size_t>(length);
  if (length < 0 || used + 64 > size) return 0;
  used += static_cast<size_t>(snprintf(text + used, size - used, ";%d;%d;%d;%d;%d;%d;%lu;%d", one.replies,
                                            one.temperature, one.fault, other.replies, other.temperature, other.fault,
                                            static_cast<unsigned long>(reply.clock), static_cast<int>(reply.status)));
  if (used + 8 > size) return 0;
  const unsigned check = crc8(text, used);
  used += static_cast<size_t>(snprintf(text + used, size - used, ";*%02X", check));
  text[used++] = '|';
  return used;
}

bool CommandReader::feed(char byte, Command* command) {
  const size_t start = waiting_ ? ends_[waiting_ - 1] : 0;
  if (byte != '|') {
    if (open_ <= kLongestPart) text_[start + open_++] = byte;
    return false;
  }
  const size_t size = open_;
  open_ = 0;
  if (!synchronised_) {  // a string that was joined in its middle can look like a shorter one
    synchronised_ = true;
    return false;
  }
  if (size > kLongestPart) {
    ++rejected_;
    waiting_ = 0;
    return false;
  }
  text_[start + size] = '|';
  ends_[waiting_++] = start + size + 1;
  return waiting_ == 3 && take(command);
}

bool CommandReader::take(Command* command) {
  if (decode_command(text_, ends_[2], command)) {
    waiting_ = 0;
    return true;
  }
  ++rejected_;  // the string may begin with the next part
  const size_t first = ends_[0];
  memmove(text_, text_ + first, ends_[2] - first);
  ends_[0] = ends_[1] - first;
  ends_[1] = ends_[2] - first;
  waiting_ = 2;
  return false;
}

}  // namespace aerodima
