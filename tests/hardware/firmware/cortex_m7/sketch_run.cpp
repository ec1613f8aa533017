// The sketch on a model of the Teensy: scenarios of bus, computer and clock. One line each: name, then named numbers.
//
// Compiled with the sketch's folder on the include path, for this computer and for the emulated Cortex-M7.
#include "sketch.ino"

#include <stdio.h>
#include <stdlib.h>

CanModel can_model;
usb_serial_class Serial;

namespace {

uint64_t now_us, clock_begin_us, fed_us;
bool clock_stands, watchdog_on;
double watchdog_us;
uint32_t standing_us, encoder_reads;
char line[512];
size_t line_size, line_read, replied;

uint64_t clock_us() { return clock_begin_us + (clock_stands ? standing_us : now_us); }

}  // namespace

uint32_t millis() { return static_cast<uint32_t>(clock_us() / 1000); }
uint32_t micros() { return static_cast<uint32_t>(clock_us()); }
void delayMicroseconds(uint32_t) {}
void delayNanoseconds(uint32_t) {}
void pinMode(uint8_t, uint8_t) {}
void digitalWriteFast(uint8_t pin, uint8_t value) { encoder_reads += pin == kEncoderSelect && value == LOW; }
uint8_t digitalReadFast(uint8_t) { return 1; }
void usb_serial_class::begin(long) {}
int usb_serial_class::available() { return static_cast<int>(line_size - line_read); }
int usb_serial_class::read() { return line[line_read++]; }
int usb_serial_class::availableForWrite() { return 4096; }
size_t usb_serial_class::write(const char*, size_t size) { return ++replied, size; }
uint8_t Servo::attach(int, int, int) { return 1; }
void Servo::writeMicroseconds(int value) { pulse = value; }

void model_watchdog(double timeout) {
  if (timeout > 0) watchdog_us = 1e6 * timeout, watchdog_on = true;
  fed_us = now_us;
}

namespace {

constexpr uint32_t kStepUs = CanModel::kStepUs;
enum class Computer { kGoesOn, kOrdersExit, kEntersAgain, kDies };
enum class Fault { kNone, kNoAcknowledgement, kBusOff, kOthersTalk, kClockStands };

void say(int request, uint32_t code) {
  const double position = 0.001 * code - 10;  // the time at which it was ordered
  line_size = line_read = 0;
  char text[sizeof line];
  int size = snprintf(text, sizeof text, "1;%d;%.4f;0;10;1;0|;2;%d;%.4f;0;10;1;0|;1600;1500;0;0;8;0;0", request, position,
                      request, position);
  size = snprintf(line, sizeof line, "%s;*%02X|", text, aerodima::crc8(text, static_cast<size_t>(size)));
  line_size = static_cast<size_t>(size);
}

struct Scenario {
  const char* name;
  Fault fault;
  uint32_t fault_ms;  // from 600 ms on
  Computer computer;
  uint64_t begin_us;  // of the clock
};

// At rest until 100 ms, entered then, commands from 110 ms on, the fault at 600 ms; 0.4 s more after its end.
void run(const Scenario& s) {
  now_us = fed_us = 0;
  clock_begin_us = s.begin_us;
  clock_stands = watchdog_on = false;
  line_size = line_read = replied = encoder_reads = 0;
  can_model = CanModel();
  setup();
  line[0] = '|';
  line_size = 1;
  const uint32_t fault_begin = 600, fault_end = fault_begin + s.fault_ms, end = fault_end + 400;
  int frames = 0, exits = 0, entered = 0, overtaken = 0, oldest = 0, late_enters = 0, resets = 0;
  int32_t off_at = -1, exits_at = -1, neutral_at = -1;
  int exit_seen[2] = {0, 0};
  bool stopping = false;  // since when no order but exit may follow an exit frame
  uint64_t hash = 1469598103934665603ull;
  for (; now_us < 1000ull * end; now_us += kStepUs) {
    const uint32_t ms = static_cast<uint32_t>(now_us / 1000);
    const bool faulty = s.fault != Fault::kNone && ms >= fault_begin && ms < fault_end;
    if (now_us % 10000 == 0) {
      const bool waits_for_stop = ms >= fault_begin + 50;
      const bool dead = s.computer == Computer::kDies && ms >= fault_begin + 20;
      const bool at_rest = ms < 100 || (s.computer != Computer::kGoesOn && waits_for_stop);
      stopping = dead || (at_rest && ms >= 100);
      const bool enters = ms == 100 || (s.computer == Computer::kEntersAgain && ms == fault_begin + 100);
      if (!dead) say(enters ? 1 : at_rest ? 0 : 2, ms);
    }
    if (now_us % 1000 == 0) {
      can_model.acknowledged = !(faulty && s.fault == Fault::kNoAcknowledgement);
      can_model.shorted = faulty && s.fault == Fault::kBusOff;
      can_model.busy_with_others = faulty && s.fault == Fault::kOthersTalk;
      if (faulty && s.fault == Fault::kClockStands && !clock_stands) {
        clock_stands = true;
        standing_us = static_cast<uint32_t>(now_us);
      }
    }
    CAN_message_t sent;
    if (can_model.advance(&sent)) {
      ++frames;
      const uint8_t* d = sent.buf;
      const uint8_t last = d[0] == 0xFF && d[6] == 0xFF ? d[7] : 0;
      const int motor = static_cast<int>(sent.id) - 1;
      for (int i = 0; i < 8; ++i) hash = (hash ^ d[i]) * 1099511628211ull;
      hash = (hash ^ (now_us + sent.id)) * 1099511628211ull;
      if (last == 0xFD) {
        ++exits;
        if (ms >= fault_begin) exit_seen[motor] = 1;
        if (off_at < 0 && exit_seen[0] && exit_seen[1]) off_at = static_cast<int32_t>(ms - fault_begin);
        if (ms >= fault_end && exits_at < 0 && exit_seen[0] && exit_seen[1]) exits_at = static_cast<int32_t>(ms - fault_end);
      } else if (last == 0xFC) {
        ++entered;
        late_enters += ms > 120;
      } else if (const int code = (d[0] << 8 | d[1]); code != 0x8000) {
        const int ordered = static_cast<int>(lround((code * 25.0 / 65535 - 12.5 + 10) * 1000));
        oldest = aerodima::larger(oldest, static_cast<int>(ms) - ordered);
      }
      overtaken += last != 0xFD && !(d[0] == 0x80 && d[1] == 0) && stopping && exit_seen[motor] && ms >= fault_end;
      if (can_model.waiting < 8) {  // the motor answers
        CAN_message_t& answer = can_model.received[can_model.waiting++];
        answer = CAN_message_t();
        answer.len = 6;
        const uint8_t data[] = {static_cast<uint8_t>(sent.id), 0x80, 0, 0x80, 0x08, 0};
        memcpy(answer.buf, data, sizeof data);
      }
    }
    loop();
    if (watchdog_on && static_cast<double>(now_us - fed_us) > watchdog_us) {
      ++resets;
      can_model.restart();
      setup();
    }
    if (ms >= fault_begin && neutral_at < 0 && servo.pulse == aerodima::kServo.idle) {
      neutral_at = static_cast<int32_t>(ms - fault_begin);
    }
  }
  printf("%s frames %d exits %d enters %d late_enters %d overtaken %d oldest_ms %d exits_ms %d exits_after_end_ms %d neutral_ms %d "
         "resets %d restarts %d encoder_reads %lu replies %lu hash %08lx\n",
         s.name, frames, exits, entered, late_enters, overtaken, oldest, static_cast<int>(off_at), static_cast<int>(exits_at),
         static_cast<int>(neutral_at), resets, can_model.restarts, static_cast<unsigned long>(encoder_reads),
         static_cast<unsigned long>(replied), static_cast<unsigned long>(hash & 0xFFFFFFFFu));
}

}  // namespace

int main() {
  const uint64_t millis_over = (1ull << 32) * 1000 - 700'000, micros_over = ((1ull << 32) - 700'000) / 1000 * 1000;
  const Scenario scenarios[] = {
      {"nothing", Fault::kNone, 400, Computer::kGoesOn, 0},
      {"millis_over", Fault::kNone, 400, Computer::kGoesOn, millis_over},
      {"micros_over", Fault::kNone, 400, Computer::kGoesOn, micros_over},
      {"dies", Fault::kNone, 400, Computer::kDies, 0},
      {"dies_millis_over", Fault::kNone, 400, Computer::kDies, millis_over},
      {"clock_stands", Fault::kClockStands, 1200, Computer::kDies, 0},
      {"others_goes_on", Fault::kOthersTalk, 300, Computer::kGoesOn, 0},
      {"others_orders_exit", Fault::kOthersTalk, 300, Computer::kOrdersExit, 0},
      {"unacknowledged_goes_on", Fault::kNoAcknowledgement, 400, Computer::kGoesOn, 0},
      {"unacknowledged_orders_exit", Fault::kNoAcknowledgement, 400, Computer::kOrdersExit, 0},
      {"unacknowledged_enters_again", Fault::kNoAcknowledgement, 400, Computer::kEntersAgain, 0},
      {"unacknowledged_dies", Fault::kNoAcknowledgement, 400, Computer::kDies, 0},
      {"bus_off_goes_on", Fault::kBusOff, 400, Computer::kGoesOn, 0},
      {"bus_off_orders_exit", Fault::kBusOff, 400, Computer::kOrdersExit, 0},
      {"bus_off_enters_again", Fault::kBusOff, 400, Computer::kEntersAgain, 0},
      {"bus_off_dies", Fault::kBusOff, 400, Computer::kDies, 0},
  };
  for (const Scenario& scenario : scenarios) run(scenario);
  return 0;
}
