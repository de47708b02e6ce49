
/*
 * Springs behind motors: the torsions as states. Entries of spring, torsion, theta and so on are of these motors alone,
 * in the order of the device file; torsions are the coordinates q[@{torsions}]. All at the joint side.
 */
typedef struct {
    @{name}_real dt;
    @{name}_real keep;
    int started;
    @{name}_real p[@{springs}];
    @{name}_real pushed[@{springs}];
    @{name}_real spring[@{springs}];
    @{name}_real torsion[@{springs}];
    @{name}_real rate[@{springs}];
    @{name}_real acceleration[@{springs}];
} @{name}_elastic;

/* gain of the estimate in rad/s (200 is a good start), dt in s; returns 1 unless both are positive. */
int @{name}_elastic_init(@{name}_elastic *state, @{name}_real gain, @{name}_real dt);

/*
 * Feed-forward, next sample of a planned motion of the links: writes the torsions that it causes into q, qd and qdd, and
 * the torque of the coordinates, terms included, into tau. Then @{name}_motor_position gives the motors' targets,
 * and @{name}_motor_torque their torques.
 */
void @{name}_elastic_plan(const @{name}_model *model, @{name}_elastic *state, @{name}_real q[@{n}],
                          @{z_declared}@{name}_real qd[@{n}], @{name}_real qdd[@{n}], @{name}_real tau[@{n}]);

/*
 * Torsion without encoders of the links, next sample: the torque of the springs through gain / (s + gain), from the
 * motors' positions, rates and torques, and what it bends them by. What moves the links does not matter, a hand included.
 */
void @{name}_elastic_estimate(const @{name}_model *model, @{name}_elastic *state, const @{name}_real theta[@{springs}],
                              const @{name}_real thetad[@{springs}], const @{name}_real motor[@{springs}], @{name}_real torsion[@{springs}],
                              @{name}_real spring[@{springs}]);
