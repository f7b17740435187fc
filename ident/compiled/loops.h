/* Joints that follow by closing equations: loop_equations.py and closing_chain.py of ident/model/kinematics/linkages. */
#ifndef DYNID_LOOPS_H
#define DYNID_LOOPS_H

#include "arm.h"
#include "vectors.h"

struct loops {
    int chains, linear, equations, passive;
    const int *chain_from; /* (chains + 1,) where each chain's links begin */
    const int *chain_rows; /* 3 or 5 equations */
    const double *before;  /* (chains, 12) rotation and origin of the first joint's frame */
    const int *link_joint, *link_prismatic;
    const double *link_sign, *link_axis, *link_after; /* (.,), (., 3), (., 12) */
    const double *coefficients, *right;               /* (linear, n), (linear,) */
    const double *rows;                               /* (passive, equations) */
    const int *passive_joint;
    double sign, step_tolerance, missed, branch_distance;
    int newton_steps;
};

struct arm {
    const struct tree *tree;
    int motors;
    const int *active;      /* (a,) the joints with a motor */
    const double *inertial; /* (n, 10) XX XY XZ YY YZ ZZ MX MY MZ M of each link, in its frame */
    const double *rotors;   /* (a, a) */
    double *follow;         /* (n, a) dq_tree/dq; written where there are loops */
    double *placed;         /* (n,) position of the tree: where nothing is solved, its constant part */
    const struct loops *loops;
};

/* One loop: end and z axis of its last frame in its first, and what each joint of it does to both. */
static void follow_chain(const struct loops *loops, int chain, const double *position, double *value,
                         double (*turning)[3], double (*derivative)[6])
{
    double rotation[9], origin[3], turned[9], next[9];
    memcpy(rotation, loops->before + 12 * chain, sizeof rotation);
    memcpy(origin, loops->before + 12 * chain + 9, sizeof origin);
    int first = loops->chain_from[chain], count = loops->chain_from[chain + 1] - first;
    double origins[count][3];
    for (int k = 0; k < count; k++) {
        int link = first + k;
        const double *axis = loops->link_axis + 3 * link, *after = loops->link_after + 12 * link;
        double sign = loops->link_sign[link], travel = position[loops->link_joint[link]], own[3], step[3];
        times(rotation, axis, own);
        for (int i = 0; i < 3; i++) {
            own[i] *= sign;
            origins[k][i] = origin[i];
            turning[k][i] = loops->link_prismatic[link] ? 0.0 : own[i];
            derivative[k][i] = loops->link_prismatic[link] ? own[i] : 0.0;
            derivative[k][3 + i] = 0.0;
            if (loops->link_prismatic[link])
                origin[i] += travel * own[i];
        }
        if (!loops->link_prismatic[link]) {
            double s = sin(sign * travel), c = cos(sign * travel), x = axis[0], y = axis[1], z = axis[2], v = 1.0 - c;
            double turn[9] = {c + x * x * v, x * y * v - z * s, x * z * v + y * s, x * y * v + z * s, c + y * y * v,
                              y * z * v - x * s, x * z * v - y * s, y * z * v + x * s, c + z * z * v};
            product(rotation, turn, turned);
        } else {
            memcpy(turned, rotation, sizeof turned);
        }
        times(turned, after + 9, step);
        for (int i = 0; i < 3; i++)
            origin[i] += step[i];
        product(turned, after, next);
        memcpy(rotation, next, sizeof rotation);
    }
    for (int i = 0; i < 3; i++)
        value[i] = origin[i], value[3 + i] = rotation[3 * i + 2];
    for (int k = 0; k < count; k++) {
        double arm[3] = {origin[0] - origins[k][0], origin[1] - origins[k][1], origin[2] - origins[k][2]}, swing[3];
        cross(turning[k], arm, swing);
        for (int i = 0; i < 3; i++)
            derivative[k][i] += swing[i];
        cross(turning[k], value + 3, derivative[k] + 3);
    }
}

/* Residual (equations,), and W times the derivatives (passive, n), at a position of the tree. */
static void closing(const struct loops *loops, int joints, const double *position, double *residual, double *reduced)
{
    double full[loops->equations * joints];
    memset(full, 0, sizeof full);
    int start = 0;
    for (int chain = 0; chain < loops->chains; chain++) {
        int first = loops->chain_from[chain], count = loops->chain_from[chain + 1] - first;
        double value[6], turning[count][3], derivative[count][6];
        follow_chain(loops, chain, position, value, turning, derivative);
        for (int row = 0; row < loops->chain_rows[chain]; row++, start++) {
            residual[start] = value[row];
            for (int k = 0; k < count; k++)
                full[start * joints + loops->link_joint[first + k]] = derivative[k][row];
        }
    }
    for (int row = 0; row < loops->linear; row++, start++) {
        const double *coefficients = loops->coefficients + row * joints;
        residual[start] = dot(joints, coefficients, position) - loops->right[row];
        memcpy(full + start * joints, coefficients, sizeof(double) * (unsigned)joints);
    }
    for (int row = 0; row < loops->passive; row++)
        for (int joint = 0; joint < joints; joint++) {
            double total = 0.0;
            for (int k = 0; k < loops->equations; k++)
                total += loops->rows[row * loops->equations + k] * full[k * joints + joint];
            reduced[row * joints + joint] = total;
        }
}

/* Move the tree to a position (a,) of the motors; `inverse` (p, p) of the derivatives by the passive joints. */
static int close_loops(const struct arm *arm, const double *position, double *inverse)
{
    const struct loops *loops = arm->loops;
    int joints = arm->tree->joints, count = loops->passive;
    double tree[joints], guess[count], residual[loops->equations], reduced[count * joints], own[count * count];
    memcpy(tree, arm->placed, sizeof tree);
    for (int motor = 0; motor < arm->motors; motor++) {
        double moved_by = position[motor] - arm->placed[arm->active[motor]];
        for (int k = 0; k < count; k++)
            tree[loops->passive_joint[k]] += arm->follow[loops->passive_joint[k] * arm->motors + motor] * moved_by;
        tree[arm->active[motor]] = position[motor];
    }
    for (int k = 0; k < count; k++)
        guess[k] = tree[loops->passive_joint[k]];
    int solved = 0, evaluated = 0;
    for (int round = 0; round <= loops->newton_steps; round++) {
        closing(loops, joints, tree, residual, reduced);
        for (int row = 0; row < count; row++)
            for (int k = 0; k < count; k++)
                own[row * count + k] = reduced[row * joints + loops->passive_joint[k]];
        double sign = invert(count, own, inverse), largest = 0.0;
        if (sign != loops->sign)
            return UNSOLVED;
        if (solved) { /* these are the derivatives where the last step led */
            evaluated = 1;
            break;
        }
        for (int k = 0; k < count; k++) {
            double step = 0.0;
            for (int row = 0; row < count; row++)
                step += inverse[k * count + row] * dot(loops->equations, loops->rows + row * loops->equations, residual);
            tree[loops->passive_joint[k]] -= step;
            largest = fabs(step) <= largest ? largest : fabs(step);
        }
        solved = largest <= loops->step_tolerance;
        for (int row = 0; row < loops->equations; row++)
            solved = solved && fabs(residual[row]) < loops->missed;
    }
    for (int k = 0; k < count; k++)
        evaluated = evaluated && fabs(tree[loops->passive_joint[k]] - guess[k]) < loops->branch_distance;
    if (!evaluated)
        return UNSOLVED;
    for (int motor = 0; motor < arm->motors; motor++)
        for (int k = 0; k < count; k++) {
            double total = 0.0;
            for (int row = 0; row < count; row++)
                total -= inverse[k * count + row] * reduced[row * joints + arm->active[motor]];
            arm->follow[loops->passive_joint[k] * arm->motors + motor] = total;
        }
    memcpy(arm->placed, tree, sizeof tree);
    return DONE;
}

/* Accelerations (n,) of the tree that follow from its rates alone. */
static void following(const struct arm *arm, const double *inverse, const double *rate, double *acceleration)
{
    const struct loops *loops = arm->loops;
    int count = loops->passive, start = 0;
    double change[loops->equations];
    memset(change, 0, sizeof change);
    for (int chain = 0; chain < loops->chains; chain++) {
        int first = loops->chain_from[chain], links = loops->chain_from[chain + 1] - first;
        double value[6], turning[links][3], derivative[links][6], upto[3] = {0}, beyond[6] = {0}, total[6] = {0}, part[3];
        follow_chain(loops, chain, arm->placed, value, turning, derivative);
        for (int k = links - 1; k >= 0; k--) {
            double by = rate[loops->link_joint[first + k]];
            for (int half = 0; half < 6; half += 3) {
                cross(turning[k], beyond + half, part);
                for (int i = 0; i < 3; i++) {
                    total[half + i] += by * part[i];
                    beyond[half + i] += by * derivative[k][half + i];
                }
            }
        }
        for (int k = 0; k < links; k++) {
            double by = rate[loops->link_joint[first + k]];
            for (int i = 0; i < 3; i++)
                upto[i] += by * turning[k][i];
            for (int half = 0; half < 6; half += 3) {
                cross(upto, derivative[k] + half, part);
                for (int i = 0; i < 3; i++)
                    total[half + i] += by * part[i];
            }
        }
        for (int row = 0; row < loops->chain_rows[chain]; row++)
            change[start++] = total[row];
    }
    memset(acceleration, 0, sizeof(double) * (unsigned)arm->tree->joints);
    for (int k = 0; k < count; k++)
        for (int row = 0; row < count; row++)
            acceleration[loops->passive_joint[k]] -=
                inverse[k * count + row] * dot(loops->equations, loops->rows + row * loops->equations, change);
}

#endif
