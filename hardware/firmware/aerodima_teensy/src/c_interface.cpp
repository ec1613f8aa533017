#include "c_interface.h"

#include <string.h>

#include "core.h"

using namespace aerodima;

namespace {

Profile to_profile(const ad_profile& p) {
  return {p.position, p.speed, p.torque, p.kp, p.kd, p.temperature_offset, p.short_replies != 0, p.long_replies != 0};
}

MotorLimits to_limits(const ad_limits& l) {
  return {l.low, l.high, l.speed, l.torque, l.kp, l.kd, l.rated_torque, l.budget};
}

// Position, velocity, kp, kd, torque.
MitCommand to_command(const double* v) { return {v[0], v[1], v[2], v[3], v[4]}; }

CanFrame to_frame(const ad_frame& f) {
  CanFrame frame{f.id, f.extended != 0, static_cast<uint8_t>(f.length), {}};
  memcpy(frame.data, f.data, sizeof frame.data);
  return frame;
}

void copy(const CanFrame& frame, ad_frame* out) {
  out->id = frame.id;
  out->extended = frame.extended;
  out->length = frame.length;
  memcpy(out->data, frame.data, sizeof frame.data);
}

void copy(const Command& command, ad_command* out) {
  for (int i = 0; i < 2; ++i) {
    const Order& order = command.orders[i];
    const MitCommand& c = order.command;
    out->orders[i] = {{c.position, c.velocity, c.kp, c.kd, c.torque}, order.motor_id, static_cast<int32_t>(order.request)};
  }
  out->roll = command.attitude.roll;
  out->pitch = command.attitude.pitch;
  out->age = command.attitude.age;
  out->lean = command.attitude.lean;
  out->yaw_rate = command.attitude.yaw_rate;
  out->servo = command.servo;
  out->throttle = command.throttle;
}

TeensyCore* core_of(void* core) { return static_cast<TeensyCore*>(core); }

}  // namespace

void* ad_core_new(const ad_config* c, uint32_t now) {
  Config config;
  config.profile = to_profile(c->profile);
  config.owns_can = c->owns_can != 0;
  config.attitude_limit = c->attitude_limit;
  config.attitude_ms = c->attitude_ms;
  config.attitude_age_ms = c->attitude_age_ms;
  config.straight_ms = c->straight_ms;
  config.least_yaw_rate = c->least_yaw_rate;
  config.full_servo = c->full_servo;
  config.driving_throttle = c->driving_throttle;
  config.throttle_start = c->throttle_start;
  config.throttle_rate = c->throttle_rate;
  config.throttle_least = c->throttle_least;
  config.throttle_most = c->throttle_most;
  for (int i = 0; i < 2; ++i) config.limits[i] = to_limits(c->limits[i]);
  config.watchdog_ms = c->watchdog_ms;
  config.exit_burst = c->exit_burst;
  config.exit_cycles = c->exit_cycles;
  config.exit_cycle_ms = c->exit_cycle_ms;
  config.reminder_ms = c->reminder_ms;
  config.reply_wait_ms = c->reply_wait_ms;
  config.sail_bits = c->sail_bits;
  config.motor_ids[0] = c->motor_ids[0];
  config.motor_ids[1] = c->motor_ids[1];
  return new TeensyCore(config, now);
}

void ad_core_free(void* core) { delete core_of(core); }

void ad_core_feed(void* core, const char* data, size_t size, uint32_t now) { core_of(core)->feed(data, size, now); }

void ad_core_receive(void* core, const ad_frame* frame) { core_of(core)->receive(to_frame(*frame)); }

void ad_core_set_sail_word(void* core, uint32_t word) { core_of(core)->set_sail_word(word); }

void ad_core_step(void* core, uint32_t now) { core_of(core)->step(now); }

int ad_core_next_frame(void* core, ad_frame* out) {
  CanFrame frame;
  if (!core_of(core)->next_frame(&frame)) return 0;
  copy(frame, out);
  return 1;
}

size_t ad_core_take_reply(void* core, char* text, size_t size) { return core_of(core)->take_reply(text, size); }

void ad_core_state(void* core, ad_state* state) {
  const TeensyCore& c = *core_of(core);
  *state = {c.servo(), c.throttle(), static_cast<int32_t>(c.status()), c.rejected()};
}

uint8_t ad_crc8(const char* data, size_t size) { return crc8(data, size); }

int ad_decode_command(const char* text, size_t size, ad_command* out) {
  Command command;
  if (!decode_command(text, size, &command)) return 0;
  copy(command, out);
  return 1;
}

size_t ad_make_reply(const ad_reply* r, char* text, size_t size) {
  Reply reply;
  for (int i = 0; i < 2; ++i) {
    const ad_report& from = r->reports[i];
    reply.reports[i] = {from.motor_id, from.position, from.velocity, from.torque,
                        from.replies,  from.temperature, from.fault};
  }
  reply.sail = r->sail;
  reply.clock = r->clock;
  reply.status = static_cast<Status>(r->status);
  return make_reply(reply, text, size);
}

int ad_make_command(int motor_id, const double* v, const ad_profile* profile, ad_frame* out) {
  CanFrame frame;
  if (!make_command(motor_id, to_command(v), to_profile(*profile), &frame)) return 0;
  copy(frame, out);
  return 1;
}

int ad_decode_reply(const ad_frame* frame, const ad_profile* profile, ad_report* report) {
  MitReply reply;
  if (!decode_reply(to_frame(*frame), to_profile(*profile), &reply)) return 0;
  *report = {reply.position, reply.velocity, reply.torque, reply.motor_id, reply.has_health, reply.temperature, reply.fault};
  return 1;
}

int ad_limit(const ad_limits* limits, const double* replies, size_t count, const double* v, double* out) {
  MotorGuard guard(to_limits(*limits));
  for (size_t i = 0; i < count; ++i) {
    const double* r = replies + 4 * i;
    guard.take({0, r[0], r[1], r[2]}, static_cast<uint32_t>(r[3]));
  }
  const MitCommand limited = guard.limit(to_command(v));
  const double values[] = {limited.position, limited.velocity, limited.kp, limited.kd, limited.torque};
  memcpy(out, values, sizeof values);
  return 1;
}

void* ad_reader_new() { return new CommandReader(); }

void ad_reader_free(void* reader) { delete static_cast<CommandReader*>(reader); }

int ad_reader_feed(void* reader, const char* data, size_t size, ad_command* out, uint32_t* rejected) {
  CommandReader& r = *static_cast<CommandReader*>(reader);
  Command command;
  int found = 0;
  for (size_t i = 0; i < size; ++i) {
    if (r.feed(data[i], &command)) {
      copy(command, out);
      ++found;
    }
  }
  *rejected = r.rejected();
  return found;
}
