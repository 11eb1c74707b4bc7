/* Vectors and reset of QEMU's mps2-an500, a Cortex-M7: the floating-point unit on, memory cleared, files through semihosting. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

extern uint32_t stack_top;
extern char __bss_start__;
extern char __bss_end__;
extern void initialise_monitor_handles(void);
extern int main(void);
void reset(void);
void _init(void);
void _fini(void);

void _init(void)
{
}

void _fini(void)
{
}

void reset(void)
{
    *(volatile uint32_t *)0xE000ED88 |= 0xF00000U;
    __asm volatile("dsb\n isb");
    memset(&__bss_start__, 0, (size_t)(&__bss_end__ - &__bss_start__));
    initialise_monitor_handles();
    exit(main());
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {&stack_top, (const void *)reset};
