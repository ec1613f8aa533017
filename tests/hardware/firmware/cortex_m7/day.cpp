// 24 hours on the clock of the core, over the end of `millis()`: a drive in every ten minutes, its motors answering on the bus.
//
// DRIVE_MS: how long each drive commands, 600000 for the whole day without a pause.
#include <stdio.h>
#include <stdlib.h>

#include "config.h"

#ifndef DRIVE_MS
#define DRIVE_MS 800
#endif

namespace {

constexpr uint32_t kBlockMs = 600'000, kDay = 24u * 3'600'000, kBegin = 0u - kDay / 2;  // ms

struct Counts {
  unsigned long commands, enters, exits, replies, wrong_order, not_running, not_stopped;
  uint32_t hash = 2166136261u;  // of all frames and replies
  uint32_t longest_step;        // instructions, on the emulated processor with -icount shift=0

  void note(const void* bytes, size_t size) {
    for (size_t i = 0; i < size; ++i) hash = (hash ^ static_cast<const uint8_t*>(bytes)[i]) * 16777619u;
  }
};

// Counts down; one is 40 instructions.
uint32_t clock_now() {
#ifdef __arm__
  return *(volatile uint32_t*)0xE000E018;
#else
  return 0;
#endif
}

class Bench {
 public:
  Bench() : core_(aerodima_config(), kBegin), now_(kBegin) { core_.feed("|", 1, now_); }

  void say(int request, double position) {
    char text[400], line[420];
    int size = snprintf(text, sizeof text, "1;%d;%.4f;0;10;1;0|;2;%d;%.4f;0;10;1;0|;1600;1500;0;0;8;0;0", request, position,
                        request, position);
    size = snprintf(line, sizeof line, "%s;*%02X|", text, aerodima::crc8(text, static_cast<size_t>(size)));
    core_.feed(line, static_cast<size_t>(size), now_);
  }

  void pass(uint32_t ms) {
    now_ += ms;
    const uint32_t begin = clock_now();
    core_.step(now_);
    const uint32_t spent = 40 * ((begin - clock_now()) & 0xFFFFFF);
    if (spent > counts.longest_step) counts.longest_step = spent;
    aerodima::CanFrame frame;
    while (core_.next_frame(&frame)) {
      const bool exit = aerodima::is_exit(frame), enter = !exit && frame.data[0] == 0xFF && frame.data[7] == 0xFC;
      counts.exits += exit;
      counts.enters += enter;
      counts.commands += !exit && !enter;
      counts.wrong_order += !exit && stopped_;
      counts.note(&frame.id, sizeof frame.id);
      counts.note(frame.data, frame.length);
      aerodima::CanFrame answer;
      answer.length = 6;
      const uint8_t low = static_cast<uint8_t>(now_);
      const uint8_t data[] = {static_cast<uint8_t>(frame.id), 0x80, low, 0x80, 0x08, low};
      for (int i = 0; i < 6; ++i) answer.data[i] = data[i];
      core_.receive(answer);
    }
    char text[aerodima::kLongestReply];
    const size_t size = core_.take_reply(text, sizeof text);
    counts.note(text, size);
    counts.replies += size != 0;
  }

  void drive(uint32_t begin) {
    for (int k = 0; k < 5; ++k) tick(0);
    stopped_ = false;
    tick(1);
    while (now_ - begin < DRIVE_MS) {
      tick(2);
      counts.not_running += core_.status() != aerodima::Status::kRunning || core_.servo() != 1600;
    }
  }

  void rest(uint32_t begin) {
    for (int k = 0; k < 200 && now_ - begin < kBlockMs; ++k) pass(1);
    stopped_ = now_ - begin < kBlockMs;
    while (now_ - begin < kBlockMs) {
      pass(aerodima::smaller<uint32_t>(1000, kBlockMs - (now_ - begin)));
      counts.not_stopped += core_.status() != aerodima::Status::kWatchdogActed || core_.servo() != aerodima::kServo.idle;
    }
  }

  uint32_t now() const { return now_; }
  unsigned long rejected() const { return core_.rejected(); }

  Counts counts = {};

 private:
  void tick(int request) {
    say(request, 0.001 * static_cast<double>(now_ % 1000));
    for (int k = 0; k < 10; ++k) pass(1);
  }

  aerodima::TeensyCore core_;
  uint32_t now_;
  bool stopped_ = false;  // from 0.2 s after a drive: no command may leave any more
};

}  // namespace

int main() {
  Bench bench;
  char* heap = nullptr;
  while (bench.now() - kBegin < kDay) {
    const uint32_t begin = bench.now();
    bench.drive(begin);
    bench.rest(begin);
    if (heap) continue;
    heap = static_cast<char*>(malloc(1));  // newlib keeps what it needs to read and write numbers from the first time on
    free(heap);
  }
  char* later = static_cast<char*>(malloc(1));
  const Counts& c = bench.counts;
  printf("commands %lu enters %lu exits %lu replies %lu wrong_order %lu not_running %lu not_stopped %lu rejected %lu heap %d hash %lu\n",
         c.commands, c.enters, c.exits, c.replies, c.wrong_order, c.not_running, c.not_stopped, bench.rejected(),
         heap == later, static_cast<unsigned long>(c.hash));
  printf("longest_step %lu\n", static_cast<unsigned long>(c.longest_step));
  return 0;
}
