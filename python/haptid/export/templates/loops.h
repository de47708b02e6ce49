
/*
 * Passive joints of loops that are not linear. Their positions z are the caller's: @{name}_loops_start once, with the
 * first sample, then @{name}_loops_update at every sample before all other functions, which take loops.z. Both return 1
 * and leave z as it is where the loops do not close: beyond the mechanism's reach, near a singular pose, or with a
 * sample too far from the one before. The other functions check none of that.
 */
typedef struct {
    @{name}_real z[@{m}];
    @{name}_real bound; /* on the error of z, rad or sizes of the mechanism, beyond rounding */
} @{name}_loops;

/* Pose from which @{name}_loops_start begins: it chooses the assembly mode. */
extern const @{name}_real @{name}_start_q[@{n}];
extern const @{name}_real @{name}_start_z[@{m}];

/* From the start pose to the first sample, on the straight line, in @{segments} steps. */
int @{name}_loops_start(@{name}_loops *loops, const @{name}_real q[@{n}]);

/* Next sample. */
int @{name}_loops_update(@{name}_loops *loops, const @{name}_real q[@{n}]);

