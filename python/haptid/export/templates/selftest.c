/* Compares the code with reference values of the Python model. Returns 0 where all agree. */
#include "@{name}.h"

#include <math.h>
#include <stdio.h>

#define N @{NAME}_COORDINATES
#define SAMPLES @{samples}
/* Maximum difference of an output, relative to its largest entry. */
#define TOLERANCE @{tolerance}

static int failures = 0;

/* Differences of one output at one sample, relative to the output's largest entry over all samples. */
static void compare(const char *what, int sample, int size, const @{name}_real got[], const double wanted[], double scale)
{
    int i;
    for (i = 0; i < size; i++) {
        const double error = fabs((double)got[i] - wanted[i]);
        if (!(error <= (TOLERANCE * scale))) {
            (void)printf("%s, sample %d, entry %d: %.17g, wanted %.17g\n", what, sample, i, (double)got[i], wanted[i]);
            failures++;
        }
    }
}

@{values}

static void check_functions(const @{name}_model *model)
{
    int i;
    for (i = 0; i < SAMPLES; i++) {
@{calls}
    }
    (void)model;
}

static void check_loops(const @{name}_model *model)
{
    @{name}_observer observer;
    @{name}_differentiator filter;
    @{name}_real made[N];
    int i;
    failures += @{name}_observer_init(&observer, @{gain}, @{step});
    failures += @{name}_differentiator_init(&filter, @{cutoff}, @{step});
@{loops_start}    for (i = 0; i < SAMPLES; i++) {
@{loops_checked}        @{name}_observer_update(model, &observer, path_q[i], @{z}path_qd[i], path_tau[i], made);
        compare("observer", i, N, made, observer_wanted[i], @{observer_scale});
        @{name}_differentiator_update(&filter, path_q[i], made);
        compare("differentiator", i, N, made, differentiator_wanted[i], @{differentiator_scale});
    }
}

int main(void)
{
    static @{name}_model model;
    @{name}_init(&model, @{name}_beta);
    check_functions(&model);
    check_loops(&model);
    (void)printf("%s: %d differences\n", "@{name}", failures);
    return (failures == 0) ? 0 : 1;
}
