// What the Teensy's core library has, and a C++ program without its standard library lacks.
#include <stdlib.h>

void* operator new(size_t size) { return malloc(size); }
void operator delete(void* memory) { free(memory); }
void operator delete(void* memory, size_t) { free(memory); }
