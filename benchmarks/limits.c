/* The machine's own limits. */
#define _POSIX_C_SOURCE 199309L
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Vectors as wide as the machine's, enough of them to hide the latency. */
#ifdef __AVX512F__
#define LANES 8
#else
#define LANES 4
#endif
typedef double lane __attribute__((vector_size(8 * LANES)));

double multiply_add_peak(void)
{
    lane a0 = {0}, a1 = a0, a2 = a0, a3 = a0, a4 = a0, a5 = a0, a6 = a0, a7 = a0, a8 = a0, a9 = a0;
    lane x = a0 + 1.0000001, y = a0 + 1e-9;
    const int turns = 20000;
    double begin = seconds();
    for (int k = 0; k < turns; k++) {
        a0 = a0 * x + y, a1 = a1 * x + y, a2 = a2 * x + y, a3 = a3 * x + y, a4 = a4 * x + y;
        a5 = a5 * x + y, a6 = a6 * x + y, a7 = a7 * x + y, a8 = a8 * x + y, a9 = a9 * x + y;
        __asm__ volatile("" : "+x"(a0), "+x"(a1), "+x"(a2), "+x"(a3), "+x"(a4), "+x"(x), "+x"(y));
        __asm__ volatile("" : "+x"(a5), "+x"(a6), "+x"(a7), "+x"(a8), "+x"(a9));
    }
    return 2e-9 * 10 * LANES * turns / (seconds() - begin);
}

double fill_speed(void)
{
    const size_t bytes = (size_t)64 << 20;
    char *memory = malloc(bytes);
    memset(memory, 1, bytes);
    __asm__ volatile("" : : "r"(memory) : "memory");
    double begin = seconds();
    memset(memory, 2, bytes);
    __asm__ volatile("" : : "r"(memory) : "memory");
    double taken = seconds() - begin;
    double sum = memory[bytes / 2];
    free(memory);
    return sum > 0 ? 1e-9 * (double)bytes / taken : 0;
}
