/* A step of Moreau's midpoint rule (ident/simulation/time_stepping.py), of an arm whose joints have motors of their
 * own, follow linearly, or follow by closing equations. */
#include "bodies.h"
#include "dry_friction.h"
#include "loops.h"

struct run {
    double step, precision, diverged;
    int rounds, directions;
    double *position, *velocity, *torque;       /* (N, a) */
    const double *viscous, *driving, *steady;   /* (a, a), (a,) that falls with the velocity, (a,) of the bias */
    const double *motion, *limit, *travel;      /* (directions, a), (directions,) of dry friction, its travel over h */
    double *dry, *change, *state;               /* (directions,), (a,), (directions,) of the step before */
};

/* What the motors see (a,) of torques (n,) at the tree. */
static void at_motors(const struct arm *arm, const double *of_tree, double *torque)
{
    int count = arm->motors;
    if (!arm->follow) {
        memcpy(torque, of_tree, sizeof(double) * (unsigned)count);
        return;
    }
    memset(torque, 0, sizeof(double) * (unsigned)count);
    for (int joint = 0; joint < arm->tree->joints; joint++)
        for (int motor = 0; motor < count; motor++)
            torque[motor] += arm->follow[joint * count + motor] * of_tree[joint];
}

static void inertia(const struct arm *arm, const struct body *bodies, double *matrix)
{
    int joints = arm->tree->joints, count = arm->motors;
    double of_tree[joints * joints], half[joints * count];
    tree_inertia(arm->tree, bodies, of_tree);
    memcpy(matrix, arm->rotors, sizeof(double) * (unsigned)(count * count));
    if (!arm->follow) {
        for (int i = 0; i < count * count; i++)
            matrix[i] += of_tree[i];
        return;
    }
    for (int joint = 0; joint < joints; joint++)
        for (int motor = 0; motor < count; motor++) {
            double total = 0.0;
            for (int other = 0; other < joints; other++)
                total += of_tree[joint * joints + other] * arm->follow[other * count + motor];
            half[joint * count + motor] = total;
        }
    for (int joint = 0; joint < joints; joint++)
        for (int i = 0; i < count; i++)
            for (int j = 0; j < count; j++)
                matrix[i * count + j] += arm->follow[joint * count + i] * half[joint * count + j];
}

static void bias(const struct arm *arm, const struct body *bodies, const double *inverse, const double *velocity,
                 double *torque)
{
    int joints = arm->tree->joints;
    double rate[joints], faster[joints], of_tree[joints];
    for (int joint = 0; joint < joints; joint++)
        rate[joint] = arm->follow ? dot(arm->motors, arm->follow + joint * arm->motors, velocity) : velocity[joint];
    if (arm->loops)
        following(arm, inverse, rate, faster);
    tree_torque(arm->tree, bodies, rate, arm->loops ? faster : NULL, of_tree);
    at_motors(arm, of_tree, torque);
}

/* u over what Dahl's state adds to dry friction over a step at a velocity (`_compliance` of time_stepping.py). */
static double compliance(double rate, double travel, double limit, double state)
{
    const double full = 1e-9;
    if (!(travel > 0.0))
        return 0.0;
    double passed = fabs(rate) / travel, covered = passed > 0.0 ? -expm1(-passed) / passed : 1.0;
    double room = 1.0 - (rate > 0.0 ? state : rate < 0.0 ? -state : 0.0);
    return travel / (limit * covered * fmax(room, full));
}

/* One step from row `index`; the row behind it is written, and what the next step begins with. */
int dynid_step(const struct arm *arm, struct run *run, int index)
{
    int count = arm->motors, joints = arm->tree->joints, passive = arm->loops ? arm->loops->passive : 0, dry = 0;
    double h = run->step, middle[count], tree[joints], closed[passive * passive + 1], mass[count * count];
    double *q = run->position + index * count, *v = run->velocity + index * count, *torque = run->torque + index * count;
    struct body bodies[joints];
    for (int i = 0; i < count; i++)
        middle[i] = q[i] + 0.5 * h * v[i];
    if (arm->loops && close_loops(arm, middle, closed) != DONE)
        return UNSOLVED;
    for (int joint = 0; joint < joints && !arm->loops; joint++)
        tree[joint] = arm->follow ? arm->placed[joint] + dot(count, arm->follow + joint * count, middle) : middle[joint];
    place(arm->tree, arm->inertial, arm->loops ? arm->placed : tree, bodies);
    inertia(arm, bodies, mass);
    if (!positive_definite(count, mass))
        return UNSOLVED;
    double damped[count * count], inverse[count * count], start[count], free[count], held[count], load[count];
    for (int i = 0; i < count * count; i++)
        damped[i] = mass[i] + 0.5 * h * run->viscous[i];
    if (invert(count, damped, inverse) == 0.0)
        return UNSOLVED;
    for (int i = 0; i < count; i++)
        free[i] = dot(count, mass + i * count, v)
                  + h * (torque[i] - run->driving[i] - run->steady[i] - 0.5 * dot(count, run->viscous + i * count, v));
    int all = run->directions, place_of[all + 1];
    for (int i = 0; i < all; i++)
        if (run->limit[i] > 0.0)
            place_of[dry++] = i;
    double to_velocity[count * dry + 1], matrix[dry * dry + 1], limit[dry + 1], friction[dry + 1], slip[dry + 1];
    double stiff[dry + 1];
    for (int k = 0; k < dry; k++) {
        limit[k] = run->limit[place_of[k]];
        friction[k] = run->dry[place_of[k]];
        for (int i = 0; i < count; i++)
            to_velocity[i * dry + k] = dot(count, inverse + i * count, run->motion + place_of[k] * count);
    }
    for (int k = 0; k < dry; k++)
        for (int other = 0; other < dry; other++) {
            double total = 0.0;
            for (int i = 0; i < count; i++)
                total += run->motion[place_of[k] * count + i] * to_velocity[i * dry + other];
            matrix[k * dry + other] = h * total;
            if (other == k)
                stiff[k] = h * total;
        }
    double after[count], change = 0.0;
    for (int i = 0; i < count; i++)
        after[i] = v[i] + run->change[i];
    for (int round = 0; round < run->rounds; round++) {
        double before = change, largest = 0.0;
        for (int i = 0; i < count; i++)
            start[i] = after[i], held[i] = 0.5 * (v[i] + after[i]);
        bias(arm, bodies, closed, held, load);
        for (int i = 0; i < count; i++)
            load[i] = free[i] - h * load[i];
        for (int i = 0; i < count; i++)
            after[i] = dot(count, inverse + i * count, load);
        if (dry) {
            for (int k = 0; k < dry; k++) {
                const double *motion = run->motion + place_of[k] * count;
                double state = run->state[place_of[k]];
                double yielding = compliance(dot(count, motion, start), run->travel[place_of[k]], limit[k], state);
                matrix[k * dry + k] = stiff[k] + yielding;
                slip[k] = dot(count, motion, after) + yielding * limit[k] * state;
            }
            if (dynid_dry_friction(dry, matrix, slip, limit, friction) != DONE)
                return UNSOLVED;
            for (int i = 0; i < count; i++)
                after[i] -= h * dot(dry, to_velocity + i * dry, friction);
        }
        change = 0.0;
        for (int i = 0; i < count; i++) {
            if (!(fabs(after[i]) < run->diverged))
                return UNSOLVED;
            change = fmax(change, fabs(after[i] - start[i]));
            largest = fmax(largest, fabs(after[i]));
        }
        double coming = before != 0.0 ? change * fmin(1.0, change / before) : change;
        if (coming <= run->precision * fmax(1.0, largest))
            break;
    }
    for (int k = 0; k < dry; k++) {
        run->dry[place_of[k]] = friction[k];
        run->state[place_of[k]] = run->travel[place_of[k]] > 0.0 ? friction[k] / limit[k] : 0.0;
    }
    for (int i = 0; i < count; i++) {
        run->change[i] = after[i] - v[i];
        v[count + i] = after[i];
        q[count + i] = middle[i] + 0.5 * h * after[i];
    }
    return DONE;
}
