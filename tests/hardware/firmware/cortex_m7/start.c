// Start of a program on the emulated Cortex-M7: memory, constructors, files and standard output of the host (semihosting).
#include <stdint.h>

extern uint32_t data_load, data_begin, data_end, bss_begin, bss_end, stack_top;
int main(void);
void exit(int);
void initialise_monitor_handles(void);
void __libc_init_array(void);

void reset(void) {
  *(volatile uint32_t*)0xE000ED88 |= 0xFu << 20;  // the floating-point unit
  __asm volatile("dsb\nisb");
  for (uint32_t *from = &data_load, *to = &data_begin; to < &data_end;) *to++ = *from++;
  for (uint32_t* to = &bss_begin; to < &bss_end;) *to++ = 0;
  *(volatile uint32_t*)0xE000E014 = 0xFFFFFF;  // SysTick counts down at 25 MHz: with -icount shift=0 once in 40 instructions
  *(volatile uint32_t*)0xE000E018 = 0;
  *(volatile uint32_t*)0xE000E010 = 5;
  initialise_monitor_handles();
  __libc_init_array();
  exit(main());
}

static void fault(void) { exit(3); }

__attribute__((section(".vectors"), used)) static void* const vectors[16] = {
    &stack_top, reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, fault, fault, 0, fault, fault};

void _init(void) {}
void _fini(void) {}
