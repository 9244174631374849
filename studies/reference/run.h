/* What Python calls. */
#ifndef RUN_H
#define RUN_H

typedef struct {
    double stiffness[2], exponent[2], damping[2], layer_depth; /* layer_depth < 0: one layer */
    double loss, least_speed;
    int tension;
    double mass, a, b, slope;
} Constants;

typedef struct {
    double tolerance;       /* of a step's velocity [m/s]; its height's is as much in metres, per second of duration */
    double force_tolerance; /* [N] */
    int degree;             /* of the power series */
    double most_cost;       /* terms and stages that a tick may take */
    int implicit;           /* whether all steps in contact are implicit */
} Accuracy;

#endif
