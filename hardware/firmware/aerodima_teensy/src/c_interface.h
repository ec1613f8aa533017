// The core behind C functions, for ctypes. Times in ms; see core.h. The sketch does not use this file.
#pragma once
#include <stddef.h>
#include <stdint.h>

extern "C" {

struct ad_frame {
  uint32_t id;
  int32_t extended, length;
  uint8_t data[8];
};

struct ad_profile {
  double position, speed, torque, kp, kd;
  int32_t temperature_offset, short_replies, long_replies;
};

struct ad_limits {
  double low, high, speed, torque, kp, kd, rated_torque, budget;
};

struct ad_config {
  ad_profile profile;
  ad_limits limits[2];
  double attitude_limit, throttle_start, throttle_rate, least_yaw_rate;
  int32_t owns_can;
  uint32_t watchdog_ms, exit_burst, exit_cycles, exit_cycle_ms, reminder_ms, reply_wait_ms, attitude_ms, attitude_age_ms, straight_ms;
  int32_t sail_bits, motor_ids[2], throttle_least, throttle_most, full_servo, driving_throttle;
};

struct ad_order {
  double values[5];  // position, velocity, kp, kd, torque
  int32_t motor_id, request;
};

struct ad_command {
  ad_order orders[2];
  double roll, pitch, lean, yaw_rate;
  int32_t servo, throttle, age;
};

struct ad_report {
  double position, velocity, torque;
  int32_t motor_id, replies, temperature, fault;
};

struct ad_reply {
  ad_report reports[2];
  double sail;
  uint32_t clock;
  int32_t status;
};

struct ad_state {
  int32_t servo, throttle, status;
  uint32_t rejected;
};

void* ad_core_new(const ad_config* config, uint32_t now);
void ad_core_free(void* core);
void ad_core_feed(void* core, const char* data, size_t size, uint32_t now);
void ad_core_receive(void* core, const ad_frame* frame);
void ad_core_set_sail_word(void* core, uint32_t word);
void ad_core_step(void* core, uint32_t now);
int ad_core_next_frame(void* core, ad_frame* frame);
size_t ad_core_take_reply(void* core, char* text, size_t size);
void ad_core_state(void* core, ad_state* state);

// The pure functions, which the tests compare with the Python ones. 0: refused.
uint8_t ad_crc8(const char* data, size_t size);
int ad_decode_command(const char* text, size_t size, ad_command* command);
size_t ad_make_reply(const ad_reply* reply, char* text, size_t size);
int ad_make_command(int motor_id, const double* values, const ad_profile* profile, ad_frame* frame);
int ad_decode_reply(const ad_frame* frame, const ad_profile* profile, ad_report* report);

// A motor's last limits with the replies (position, velocity, torque, ms) that came before.
int ad_limit(const ad_limits* limits, const double* replies, size_t count, const double* values, double* limited);

// A stream of its own: what `ad_reader_feed` finds in the bytes, newest command only, with the number of commands.
void* ad_reader_new();
void ad_reader_free(void* reader);
int ad_reader_feed(void* reader, const char* data, size_t size, ad_command* command, uint32_t* rejected);
}
