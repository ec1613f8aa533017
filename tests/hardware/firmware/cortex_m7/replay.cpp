// Calls of the core's C functions that the host has recorded, made again here: every result and every byte must be equal.
//
// A record (../recorded.py): number of the function, each argument, the result, then the arguments that the call may write.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "c_interface.h"

namespace {

constexpr int kMostArguments = 5, kMostHandles = 4096, kFunctions = 18;
constexpr uint32_t kMostBytes = 8192;

struct Argument {
  uint32_t size;
  alignas(8) uint8_t bytes[kMostBytes];
  char* text() { return reinterpret_cast<char*>(bytes); }
  template <class T>
  T* as() {
    return reinterpret_cast<T*>(bytes);
  }
  uint32_t number() { return static_cast<uint32_t>(*as<int64_t>()); }
};

Argument a[kMostArguments], expected;
struct Handle {
  int64_t name;
  void* object;
} handles[kMostHandles];
int handle_count;
FILE* file;

bool take(void* to, size_t size) { return fread(to, 1, size, file) == size; }

bool take(Argument* argument) {
  return take(&argument->size, 4) && argument->size <= kMostBytes && take(argument->bytes, argument->size);
}

Handle* find(int64_t name) {
  int i = 0;
  while (i < handle_count && handles[i].name != name) ++i;
  if (i == kMostHandles) exit(2);
  if (i == handle_count) ++handle_count;
  handles[i].name = name;
  return &handles[i];
}

void* object(Argument& argument) { return find(*argument.as<int64_t>())->object; }

uint32_t clock_now() {
#ifdef __arm__
  return *(volatile uint32_t*)0xE000E018;
#else
  return 0;
#endif
}

// Same order as FUNCTIONS of ../recorded.py. Functions that make an object return it in `made`.
int64_t call(int function, void** made) {
  switch (function) {
    case 0: *made = ad_core_new(a[0].as<ad_config>(), a[1].number()); return 0;
    case 1: ad_core_free(object(a[0])); return 0;
    case 2: ad_core_feed(object(a[0]), a[1].text(), a[2].number(), a[3].number()); return 0;
    case 3: ad_core_receive(object(a[0]), a[1].as<ad_frame>()); return 0;
    case 4: ad_core_set_sail_word(object(a[0]), a[1].number()); return 0;
    case 5: ad_core_step(object(a[0]), a[1].number()); return 0;
    case 6: return ad_core_next_frame(object(a[0]), a[1].as<ad_frame>());
    case 7: return ad_core_take_reply(object(a[0]), a[1].text(), a[2].number());
    case 8: ad_core_state(object(a[0]), a[1].as<ad_state>()); return 0;
    case 9: return ad_crc8(a[0].text(), a[1].number());
    case 10: return ad_decode_command(a[0].text(), a[1].number(), a[2].as<ad_command>());
    case 11: return ad_make_reply(a[0].as<ad_reply>(), a[1].text(), a[2].number());
    case 12: return ad_make_command(static_cast<int>(a[0].number()), a[1].as<double>(), a[2].as<ad_profile>(), a[3].as<ad_frame>());
    case 13: return ad_decode_reply(a[0].as<ad_frame>(), a[1].as<ad_profile>(), a[2].as<ad_report>());
    case 14: return ad_limit(a[0].as<ad_limits>(), a[1].as<double>(), a[2].number(), a[3].as<double>(), a[4].as<double>());
    case 15: *made = ad_reader_new(); return 0;
    case 16: ad_reader_free(object(a[0])); return 0;
    case 17: return ad_reader_feed(object(a[0]), a[1].text(), a[2].number(), a[3].as<ad_command>(), a[4].as<uint32_t>());
  }
  return -1;
}

}  // namespace

int main() {
  file = fopen("calls.bin", "rb");
  if (!file) return 2;
  setvbuf(file, nullptr, _IOFBF, 1 << 16);
  unsigned long calls[kFunctions] = {}, longest[kFunctions] = {}, total = 0;
  uint8_t head[2], written;
  while (take(head, 2)) {
    const int function = head[0];
    for (int i = 0; i < head[1]; ++i) {
      if (!take(&a[i])) return 2;
    }
    int64_t result;
    void* made = nullptr;
    const uint32_t begin = clock_now();
    const int64_t found = call(function, &made);
    const unsigned long spent = 40 * ((begin - clock_now()) & 0xFFFFFF);
    if (!take(&result, 8) || !take(&written, 1)) return 2;
    if (made) find(result)->object = made;
    bool equal = made || found == result;
    for (int i = 0; i < head[1]; ++i) {
      if (!(written >> i & 1)) continue;
      if (!take(&expected)) return 2;
      equal = equal && !memcmp(a[i].bytes, expected.bytes, expected.size);
    }
    ++calls[function];
    if (spent > longest[function]) longest[function] = spent;
    if (!equal) {
      printf("different: call %lu, function %d\n", total, function);
      return 1;
    }
    ++total;
  }
  printf("equal %lu\n", total);
  for (int i = 0; i < kFunctions; ++i) printf("function %d calls %lu longest %lu\n", i, calls[i], longest[i]);
  return 0;
}
