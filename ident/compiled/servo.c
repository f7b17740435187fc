/* Roll-outs of servo joints (ident/servo/rollout.py, whose NumPy code computes the same): lanes are columns. */
#include <math.h>

/* The order of TERMS in ident/servo/terms.py. */
enum { STIFFNESS, DAMPING, ARMATURE, COULOMB, BIAS, DELAY, ACCELERATION_LIMIT, LOAD_FRICTION, ZERO, BREAKAWAY,
       LOAD_BREAKAWAY, STRIBECK_VELOCITY, TORQUE_LIMIT, DEAD_BAND, TERMS };

static double sign(double value) { return value > 0 ? 1 : value < 0 ? -1 : 0; }

/* goals (rows, lanes) of profiles at each time of commands (rows, lanes), with accelerations (lanes). */
void servo_profile(long rows, long lanes, double step, const double *command, const double *limit, double *goals)
{
    for (long lane = 0; lane < lanes; lane++) {
        double goal = command[lane], pace = 0, half = 0.5 * step * limit[lane], most = step * limit[lane];
        goals[lane] = goal;
        for (long row = 1; row < rows; row++) {
            double ahead = command[row * lanes + lane] - goal, distance = fabs(ahead);
            double braking = fmin(sqrt(2 * limit[lane] * distance + half * half) - half, distance / step);
            pace = fmin(fmax(copysign(braking, ahead), pace - most), pace + most);
            goal += step * pace;
            goals[row * lanes + lane] = goal - 0.5 * step * pace;
        }
    }
}

/* Paths (rows, lanes), and derivatives (free, rows, lanes) by the terms `term` (free): of goals (rows, lanes), which
   depend on the free terms by `d_goals` (free, rows, lanes), with values (TERMS, lanes). */
void servo_roll_out(long rows, long lanes, double step, const double *values, const double *inertias,
                    const double *loads, const double *slopes, const double *start, const double *goals, long free,
                    const long *term, const double *d_goals, double *path, double *tangents)
{
    double h = 0.5 * step;
    for (long lane = 0; lane < lanes; lane++) {
        double p[TERMS], d_position[TERMS] = {0}, d_velocity[TERMS] = {0}, position = start[lane], velocity = 0;
        for (int index = 0; index < TERMS; index++)
            p[index] = values[index * lanes + lane];
        for (long row = 0; row < rows; row++) {
            long here = row * lanes + lane;
            path[here] = position;
            for (long f = 0; f < free; f++)
                tangents[f * rows * lanes + here] = d_position[f];
            double error = goals[here] - position - p[BIAS], side = sign(error);
            int outside = fabs(error) > p[DEAD_BAND];
            double linear = outside ? p[STIFFNESS] * (error - side * p[DEAD_BAND]) : 0;
            double torque = fmin(fmax(linear, -p[TORQUE_LIMIT]), p[TORQUE_LIMIT]), loaded = fabs(torque);
            double acting = outside && torque == linear ? p[STIFFNESS] : 0, inertia = p[ARMATURE] + inertias[here];
            double momentum = inertia * velocity + h * (torque - loads[here] - p[ZERO] * slopes[here]);
            double share = velocity / p[STRIBECK_VELOCITY], faded = exp(-share * share);
            double breakaway = p[BREAKAWAY] + p[LOAD_BREAKAWAY] * loaded;
            double friction = h * (p[COULOMB] + p[LOAD_FRICTION] * loaded + breakaway * faded);
            int moving = fabs(momentum) > friction;
            double against = sign(momentum), per_torque = p[LOAD_FRICTION] + p[LOAD_BREAKAWAY] * faded;
            double passed = fmax(1 - against * sign(torque) * per_torque, 0);
            double divisor = inertia + h * p[DAMPING] + h * h * acting * passed;
            double after = moving ? (momentum - against * friction) / divisor : 0, left = torque - h * acting * after;
            loaded = sign(torque) * left;
            breakaway = p[BREAKAWAY] + p[LOAD_BREAKAWAY] * loaded;
            double fading = h * breakaway * faded * 2 * share; /* by the logarithm of the velocity where it fades: × share */
            for (long f = 0; f < free; f++) {
                if (!moving) {
                    d_velocity[f] = 0;
                    continue;
                }
                double d_torque = acting * (d_goals[f * rows * lanes + here] - d_position[f]), d_friction = 0, push = 0;
                switch (term[f]) {
                case STIFFNESS: d_torque += acting > 0 ? left : 0; break;
                case DAMPING: push = -h * p[DAMPING] * after; break;
                case ARMATURE: push = p[ARMATURE] * (velocity - after); break;
                case COULOMB: d_friction = h * p[COULOMB]; break;
                case BIAS: d_torque -= acting; break;
                case LOAD_FRICTION: d_friction = h * p[LOAD_FRICTION] * loaded; break;
                case ZERO: push = -h * slopes[here]; break;
                case BREAKAWAY: d_friction = h * p[BREAKAWAY] * faded; break;
                case LOAD_BREAKAWAY: d_friction = h * p[LOAD_BREAKAWAY] * loaded * faded; break;
                case STRIBECK_VELOCITY: d_friction = fading * share; break;
                case TORQUE_LIMIT: d_torque += outside && !(acting > 0) ? torque : 0; break;
                case DEAD_BAND: d_torque -= acting * side * p[DEAD_BAND]; break;
                }
                d_friction -= fading / p[STRIBECK_VELOCITY] * d_velocity[f];
                double middle = (inertia * d_velocity[f] + h * passed * d_torque + push - against * d_friction) / divisor;
                d_velocity[f] = 2 * middle - d_velocity[f];
                d_position[f] += step * middle;
            }
            velocity = moving ? 2 * after - velocity : 0;
            position += step * after;
        }
    }
}
