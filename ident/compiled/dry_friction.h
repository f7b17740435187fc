/* Dry friction over a step: the active set of ident/simulation/dry_friction.py. */
#ifndef DYNID_DRY_FRICTION_H
#define DYNID_DRY_FRICTION_H

#include "vectors.h"

/* Directions that stick, with the Cholesky factor of their part of W (dry_friction.py). */
struct sticking {
    int size, count;
    const double *matrix;
    int *directions;
    double *factor;
};

static void forward(const struct sticking *set, double *values)
{
    for (int place = 0; place < set->count; place++)
        values[place] = (values[place] - dot(place, set->factor + place * set->size, values))
                        / set->factor[place * set->size + place];
}

static void backward(const struct sticking *set, double *values)
{
    for (int place = set->count - 1; place >= 0; place--) {
        const double *row = set->factor + place * set->size;
        values[place] /= row[place];
        for (int above = 0; above < place; above++)
            values[above] -= row[above] * values[place];
    }
}

/* Add a direction; 0, and how the others move with it, where it depends on them. */
static int append(struct sticking *set, int direction, double *follow)
{
    const double singular = 1e-13;
    double own = set->matrix[direction * set->size + direction];
    for (int place = 0; place < set->count; place++)
        follow[place] = set->matrix[direction * set->size + set->directions[place]];
    forward(set, follow);
    double left = own - dot(set->count, follow, follow);
    if (left <= singular * own) {
        backward(set, follow);
        for (int place = 0; place < set->count; place++)
            follow[place] = -follow[place];
        return 0;
    }
    double *row = set->factor + set->count * set->size;
    memcpy(row, follow, sizeof(double) * (unsigned)set->count);
    row[set->count] = sqrt(left);
    set->directions[set->count++] = direction;
    return 1;
}

static void take_out(struct sticking *set, int direction)
{
    int place = 0, others = set->count, behind[set->size];
    double follow[set->size];
    while (set->directions[place] != direction)
        place++;
    memcpy(behind, set->directions, sizeof behind);
    for (set->count = place++; place < others; place++)
        append(set, behind[place], follow);
}

/* Move along a step to the first limit; the direction that reaches it, -1 where none does. */
static int advance(int count, double *torque, const double *step, const double *limit, double longest)
{
    int first = -1;
    double least = INFINITY;
    for (int i = 0; i < count; i++)
        if (step[i] != 0.0) {
            double room = (copysign(limit[i], step[i]) - torque[i]) / step[i];
            if (first < 0 || room < least)
                first = i, least = room;
        }
    int within = least >= longest;
    for (int i = 0; i < count; i++) {
        torque[i] += (within ? longest : least) * step[i];
        if (!within)
            torque[i] = fmin(fmax(torque[i], -limit[i]), limit[i]);
    }
    if (within)
        return -1;
    torque[first] = copysign(limit[first], step[first]);
    return first;
}

/* lambda in place of a guess, as `dry_friction` of Python. */
int dynid_dry_friction(int count, const double *matrix, const double *free, const double *limit, double *torque)
{
    const double precision = 5e-13;
    const int changes = 50;
    double still[count], velocity[count], step[count], follow[count], factor[count * count];
    int directions[count], violated[count], listed = 0;
    struct sticking set = {count, 0, matrix, directions, factor};
    for (int i = 0; i < count; i++) {
        still[i] = fabs(free[i]);
        for (int j = 0; j < count; j++)
            still[i] += fabs(matrix[i * count + j]) * limit[j];
        still[i] *= precision;
        torque[i] = fmin(fmax(torque[i], -limit[i]), limit[i]);
    }
    for (int round = 0; round < changes * count; round++) {
        int any = 0, any_sticking = 0, released = -1;
        double fastest = -1.0;
        for (int i = 0; i < count; i++) {
            velocity[i] = free[i] - dot(count, matrix + i * count, torque);
            violated[i] = fabs(velocity[i]) > still[i] && (fabs(torque[i]) < limit[i] || velocity[i] * torque[i] < 0.0);
            any |= violated[i];
            if (violated[i] && fabs(velocity[i]) / still[i] > fastest)
                fastest = fabs(velocity[i]) / still[i], released = i;
        }
        if (!any)
            return DONE;
        for (int i = 0; i < count && !listed; i++)
            if (fabs(torque[i]) < limit[i])
                append(&set, i, follow);
        listed = 1;
        memset(step, 0, sizeof step);
        for (int place = 0; place < set.count; place++)
            any_sticking |= violated[directions[place]];
        if (any_sticking) {
            for (int place = 0; place < set.count; place++)
                follow[place] = velocity[directions[place]];
            forward(&set, follow);
            backward(&set, follow);
            for (int place = 0; place < set.count; place++)
                step[directions[place]] = follow[place];
            int reached = advance(count, torque, step, limit, 1.0);
            if (reached >= 0)
                take_out(&set, reached);
            continue;
        }
        if (append(&set, released, follow))
            continue;
        for (int place = 0; place < set.count; place++)
            step[directions[place]] = copysign(follow[place], velocity[released] * follow[place]);
        step[released] = copysign(1.0, velocity[released]);
        int reached = advance(count, torque, step, limit, INFINITY);
        if (reached >= 0 && reached != released) {
            take_out(&set, reached);
            append(&set, released, follow);
        }
    }
    return UNSOLVED;
}

#endif
