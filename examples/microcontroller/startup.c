/* Start-up of a Cortex-M7 for an emulator (qemu's mps2-an500): vectors, and the floating-point unit on.
 *
 * A board brings its own: on a Teensy 4.1, add the exported .c and .o files to the sketch `knee_contact.ino`. */
#include <stdint.h>

#define CPACR (*(volatile uint32_t *)0xE000ED88) /* access to the floating-point unit */

void _start(void); /* of the C library: zeros the data, calls main and exit */

static void reset(void)
{
    CPACR |= 0xFu << 20;
    __asm__ volatile("dsb; isb");
    _start();
}

static void fault(void)
{
    for (;;)
        __asm__ volatile("bkpt 0");
}

extern uint32_t stack_top; /* memory.ld */
__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
    (void (*)(void)) & stack_top, reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, fault, fault, 0, fault, fault,
};
