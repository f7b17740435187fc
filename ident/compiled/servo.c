/* Roll-outs of servo joints (ident/servo/numpy_rollout.py and goals.py compute the same): lanes are columns. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* The order of TERMS in ident/servo/terms.py. */
enum { STIFFNESS, DAMPING, ARMATURE, COULOMB, BIAS, DELAY, ACCELERATION_LIMIT, LOAD_FRICTION, ZERO, BREAKAWAY,
       LOAD_BREAKAWAY, STRIBECK_VELOCITY, TORQUE_LIMIT, DEAD_BAND, TERMS };

static double sign(double value) { return value > 0 ? 1 : value < 0 ? -1 : 0; }
static double larger(double a, double b) { return a > b ? a : b; }
static double smaller(double a, double b) { return a < b ? a : b; }

enum { WIDTH = 8 }; /* lanes side by side */

/* goals (rows, WIDTH) of profiles at each time of `count` lanes of commands (rows, lanes), with accelerations (WIDTH). */
static void profiles(long rows, long lanes, long count, double step, const double *command, const double *limit,
                     double *goals)
{
    double goal[WIDTH], pace[WIDTH], half[WIDTH], most[WIDTH], target[WIDTH];
    for (long l = 0; l < WIDTH; l++) {
        target[l] = goals[l] = goal[l] = l < count ? command[l] : 0;
        pace[l] = 0, half[l] = 0.5 * step * limit[l], most[l] = step * limit[l];
    }
    for (long row = 1; row < rows; row++) {
        for (long l = 0; l < count; l++)
            target[l] = command[row * lanes + l];
        for (long l = 0; l < WIDTH; l++) {
            double ahead = target[l] - goal[l], distance = fabs(ahead), last = distance / step;
            double braking = sqrt(2 * limit[l] * distance + half[l] * half[l]) - half[l];
            braking = copysign(smaller(braking, last), ahead); /* never past the target in one step */
            pace[l] = smaller(larger(braking, pace[l] - most[l]), pace[l] + most[l]);
            goal[l] += step * pace[l];
            /* a sum of velocities after their steps is half a step ahead */
            goals[row * WIDTH + l] = goal[l] - 0.5 * step * pace[l];
        }
    }
}

/* goals (rows, lanes) of profiles at each time of commands (rows, lanes), with accelerations (lanes). */
void servo_profile(long rows, long lanes, double step, const double *command, const double *limit, double *goals)
{
    double *block = malloc(sizeof(double) * rows * WIDTH), own[WIDTH];
    for (long first = 0; first < lanes; first += WIDTH) {
        long count = lanes - first < WIDTH ? lanes - first : WIDTH;
        for (long l = 0; l < WIDTH; l++)
            own[l] = limit[first + (l < count ? l : 0)];
        profiles(rows, lanes, count, step, command + first, own, block);
        for (long row = 0; row < rows; row++)
            memcpy(goals + row * lanes + first, block + row * WIDTH, sizeof(double) * count);
    }
    free(block);
}

/* Delayed goals (rows + 1, lanes), of commands (history + rows, lanes), and their derivatives by the logarithm of the
   limit, as a difference over ± `span`, where they are not NULL. During a step, its own row is the goal for the `late`
   (lanes) share, and the next row for the rest. A limit of `unlimited` or more is none. */
void servo_goals(long history, long rows, long lanes, double step, double span, double unlimited,
                 const double *command, const double *delay, const double *limit, double *goals, double *late,
                 double *by_limit)
{
    long all = history + rows;
    double *block = malloc(sizeof(double) * all * WIDTH), factors[3] = {1, exp(span), exp(-span)}, steep[WIDTH];
    for (long first = 0; first < lanes; first += WIDTH) {
        long count = lanes - first < WIDTH ? lanes - first : WIDTH;
        for (int variant = 0; variant < (by_limit ? 3 : 1); variant++) {
            int limited = 0;
            for (long l = 0; l < WIDTH; l++) {
                steep[l] = factors[variant] * limit[first + (l < count ? l : 0)];
                limited |= steep[l] < unlimited;
            }
            if (limited)
                profiles(all, lanes, count, step, command + first, steep, block);
            long whole[WIDTH];
            for (long l = 0; l < count; l++) {
                whole[l] = floor(delay[first + l] / step);
                late[first + l] = delay[first + l] / step - whole[l];
            }
            for (long row = 0; row <= rows; row++)
                for (long l = 0; l < count; l++) {
                    long at = row * lanes + first + l, place = history - whole[l] + row;
                    place = place < 0 ? 0 : place > all - 1 ? all - 1 : place;
                    double goal = !(steep[l] < unlimited) || !place
                                      ? command[place * lanes + first + l]
                                      : 0.5 * (block[place * WIDTH + l] + block[(place - 1) * WIDTH + l]);
                    if (variant)
                        by_limit[at] = variant == 1 ? goal : (by_limit[at] - goal) / (2 * span);
                    else
                        goals[at] = goal;
                }
        }
    }
    free(block);
}

enum { SWEEPS = 200, PATTERNS = 6, SIDE_BY_SIDE = 8 }; /* pieces: memory is read row after row */
static const double SETTLED = 1e-9; /* [rad/s or N] change of a sweep at which the joints of a step agree */

struct servo {
    double p[TERMS], position, velocity, middle, torque, toward, acting, shares[2], limited, sided, later, inertia,
        momentum, friction, per_torque, faded, share, push, against, passed, divisor, gone, after,
        turn[3];
    int moving, turning;
};

/* Half a step of a joint on its own, without what other joints and a contact add to its momentum. The goal is `older`
   for the `late` share of the step, and `newer` for the rest: a limit holds for each, not for their mean. */
static void begin(struct servo *s, double h, double older, double newer, double late, double inertia, double load,
                  double slope)
{
    const double *p = s->p, goals[2] = {older, newer}, parts[2] = {late, 1 - late};
    double middle = s->position + h * s->velocity + p[BIAS], torques[2];
    s->torque = s->limited = s->sided = 0;
    for (int k = 0; k < 2; k++) {
        double error = goals[k] - middle, side = sign(error), outside = fabs(error) - p[DEAD_BAND];
        double linear = outside > 0 ? p[STIFFNESS] * side * outside : 0;
        torques[k] = smaller(larger(linear, -p[TORQUE_LIMIT]), p[TORQUE_LIMIT]);
        s->shares[k] = outside > 0 && torques[k] == linear ? parts[k] * p[STIFFNESS] : 0;
        s->torque += parts[k] * torques[k];
        s->limited += torques[k] == linear ? 0 : parts[k] * torques[k];
        s->sided += s->shares[k] * side;
    }
    s->acting = s->shares[0] + s->shares[1];
    s->later = torques[0] - torques[1];
    s->toward = sign(s->torque);
    s->torque += h * s->acting * s->velocity; /* as at the beginning, from where the step is implicit */
    s->inertia = p[ARMATURE] + inertia;
    s->momentum = s->inertia * s->velocity + h * (s->torque - load - p[ZERO] * slope);
    s->share = s->velocity / p[STRIBECK_VELOCITY];
    double loaded = s->toward * s->torque, breakaway = p[BREAKAWAY] + p[LOAD_BREAKAWAY] * loaded;
    s->faded = breakaway > 0 ? exp(-s->share * s->share) : 0;
    s->friction = h * (p[COULOMB] + p[LOAD_FRICTION] * loaded + breakaway * s->faded);
    s->per_torque = p[LOAD_FRICTION] + p[LOAD_BREAKAWAY] * s->faded;
    s->push = 0;
}

/* A joint that comes to rest within a step: friction reverses with it, or holds it there from then on. `turn` is its
   velocity after the step if friction had not turned, half of its fall, and the share that it moves back with. */
static void turned(struct servo *s)
{
    s->turn[0] = 2 * s->middle - s->velocity;
    s->turn[1] = s->velocity - s->middle;
    s->turn[2] = larger(1 - 2 * s->friction / (fabs(s->turn[1]) * s->divisor), 0);
    s->middle = 0.5 * (s->velocity + s->turn[2] * s->turn[0]);
    s->gone = (s->velocity * s->velocity - s->turn[2] * s->turn[0] * s->turn[0]) / (4 * s->turn[1]);
}

/* The velocity in the middle of the step, with `push` in the momentum; returns by how much it changed. */
static double move(struct servo *s, double h)
{
    double momentum = s->momentum + s->push, before = s->middle;
    s->moving = s->velocity != 0 || fabs(momentum) > s->friction;
    s->against = sign(s->velocity != 0 ? s->velocity : momentum);
    s->passed = larger(1 - s->against * s->toward * s->per_torque, 0);
    s->divisor = s->inertia + h * s->p[DAMPING] + h * h * s->acting * s->passed;
    s->gone = s->middle = s->moving ? (momentum - s->against * s->friction) / s->divisor : 0;
    s->turning = s->velocity * (2 * s->middle - s->velocity) < 0;
    if (s->turning)
        turned(s);
    return fabs(s->middle - before);
}

/* How the momentum in the middle of a step changes with each of the joint's own terms (TERMS). */
static void by_terms(const struct servo *s, double h, double by_delay, double old_by_limit, double by_limit, double slope,
                     double *own)
{
    const double *p = s->p;
    double left = s->torque - h * s->acting * s->middle, loaded = s->toward * left, push = h * s->passed;
    double drag = -s->against * h;
    own[STIFFNESS] = push * (left - s->limited);
    own[DAMPING] = -h * p[DAMPING] * s->middle;
    own[ARMATURE] = p[ARMATURE] * (s->velocity - s->middle);
    own[COULOMB] = drag * p[COULOMB];
    own[BIAS] = -push * s->acting;
    own[DELAY] = push * s->later * by_delay;
    own[ACCELERATION_LIMIT] = push * (s->shares[0] * old_by_limit + s->shares[1] * by_limit);
    own[LOAD_FRICTION] = drag * p[LOAD_FRICTION] * loaded;
    own[ZERO] = -h * slope;
    own[BREAKAWAY] = drag * p[BREAKAWAY] * s->faded;
    own[LOAD_BREAKAWAY] = drag * p[LOAD_BREAKAWAY] * loaded * s->faded;
    own[STRIBECK_VELOCITY] = drag * (p[BREAKAWAY] + p[LOAD_BREAKAWAY] * loaded) * s->faded * 2 * s->share * s->share;
    own[TORQUE_LIMIT] = push * s->limited;
    own[DEAD_BAND] = -push * s->sided * p[DEAD_BAND];
}

/* How the momentum changes with the velocity before the step, beyond the inertia: friction that fades. */
static double by_velocity(const struct servo *s, double h)
{
    double loaded = s->toward * (s->torque - h * s->acting * s->middle);
    double breakaway = s->p[BREAKAWAY] + s->p[LOAD_BREAKAWAY] * loaded;
    return s->against * h * breakaway * s->faded * 2 * s->share / s->p[STRIBECK_VELOCITY];
}

/* The Cholesky factor (n, n; below the diagonal, with its reciprocal) of what resists together the joints that move and
   do not turn. */
static void factored(long n, const struct servo *servos, const double *m, double *a)
{
    for (long i = 0; i < n; i++)
        for (long j = 0; j <= i; j++) {
            double sum = servos[i].moving > servos[i].turning && servos[j].moving > servos[j].turning ? i == j ? servos[i].divisor : m[i * n + j] : i == j;
            for (long k = 0; k < j; k++)
                sum -= a[i * n + k] * a[j * n + k];
            a[i * n + j] = i == j ? 1 / sqrt(larger(sum, 1e-300)) : sum * a[j * n + j];
        }
}

static void solved(long n, const double *factor, double *x)
{
    for (long i = 0; i < n; i++) {
        for (long k = 0; k < i; k++)
            x[i] -= factor[i * n + k] * x[k];
        x[i] *= factor[i * n + i];
    }
    for (long i = n - 1; i >= 0; i--) {
        for (long k = i + 1; k < n; k++)
            x[i] -= factor[k * n + i] * x[k];
        x[i] *= factor[i * n + i];
    }
}

/* How friction's part of the momentum, and what resists the joint, change with each of its own terms. */
static void turn_by_terms(const struct servo *s, double h, double by_delay, double old_by_limit, double by_limit,
                          double *friction, double *resists)
{
    double back[TERMS], bent = -h * h * s->acting * s->against * s->toward;
    struct servo rest = *s;
    rest.middle = 0, rest.against = 1, rest.passed = 1 - s->toward * s->per_torque;
    by_terms(&rest, h, by_delay, old_by_limit, by_limit, 0, friction);
    rest.against = -1, rest.passed = 1 + s->toward * s->per_torque;
    by_terms(&rest, h, by_delay, old_by_limit, by_limit, 0, back);
    for (int index = 0; index < TERMS; index++) {
        friction[index] = 0.5 * (back[index] - friction[index]);
        resists[index] = 0;
    }
    resists[STIFFNESS] = h * h * s->acting * s->passed;
    resists[DAMPING] = h * s->p[DAMPING];
    resists[ARMATURE] = s->p[ARMATURE];
    resists[LOAD_FRICTION] = bent * s->p[LOAD_FRICTION];
    resists[LOAD_BREAKAWAY] = bent * s->p[LOAD_BREAKAWAY] * s->faded;
}

/* Derivatives of a turning joint's `place` and `rate` from those without the turn, and from those `before` the step of
   position and, `apart` from it, velocity; friction and resistance change with its own terms by so much. */
static void turn_differentiated(const struct servo *s, double h, const double *friction, const double *resists,
                                long parameters, const int *own, const long *term, const double *before, long apart,
                                double *place, double *rate)
{
    struct servo still = *s;
    still.middle = 0;
    double by_place = -h * s->per_torque * s->toward * s->acting, by_rate = -s->against * by_velocity(&still, h);
    double without = s->turn[0], half = s->turn[1], back = s->turn[2], fall = fabs(half) * s->divisor;
    for (long k = 0; k < parameters; k++) {
        double x = before[k], v = before[apart + k], w = rate[k], u = 0.5 * (v - w);
        double rubs = by_place * x + by_rate * v + (own[k] ? friction[term[k]] : 0);
        double falls = s->against * u * s->divisor + (own[k] ? fabs(half) * resists[term[k]] : 0);
        double backs = back > 0 ? 2 * (s->friction * falls / fall - rubs) / fall : 0;
        rate[k] = back * w + without * backs;
        double squares = 2 * s->velocity * v - without * without * backs - 2 * back * without * w;
        place[k] = x + 2 * h * (squares / (4 * half) - s->gone * u / half);
    }
}

/* One round over the joints, each with the others as they are; returns the largest change of a velocity. */
static double swept(long n, struct servo *servos, double h, const double *m, const double *lever, double pressed)
{
    double change = 0;
    for (long i = 0; i < n; i++) {
        double push = lever ? h * lever[i] * pressed : 0;
        for (long j = 0; m && j < n; j++)
            push += j == i ? 0 : m[i * n + j] * (servos[j].velocity - servos[j].middle);
        servos[i].push = push;
        change = larger(change, move(servos + i, h));
    }
    return change;
}

/* Velocities of joints that move each other, from which of them move, and where to, until that is right. */
static int solved_together(long n, struct servo *servos, double h, const double *m, double *factor)
{
    double x[n];
    for (int attempt = 0; attempt < PATTERNS; attempt++) {
        int same = attempt > 0;
        for (long i = 0; i < n; i++) {
            int moving = servos[i].moving, turning = servos[i].turning;
            double against = servos[i].against, push = 0;
            for (long j = 0; j < n; j++)
                push += j == i ? 0 : m[i * n + j] * (servos[j].velocity - servos[j].middle);
            servos[i].push = push;
            double change = move(servos + i, h);
            same &= moving == servos[i].moving && (!moving || against == servos[i].against);
            same &= turning == servos[i].turning && (!turning || change < SETTLED);
        }
        if (same)
            return 1;
        factored(n, servos, m, factor);
        for (long i = 0; i < n; i++) {
            x[i] = 0;
            if (servos[i].moving <= servos[i].turning)
                continue;
            for (long j = 0; j < n; j++)
                x[i] += j == i ? 0 : m[i * n + j] * (servos[j].velocity - (servos[j].turning ? servos[j].middle : 0));
            x[i] += servos[i].momentum - servos[i].against * servos[i].friction;
        }
        solved(n, factor, x);
        for (long i = 0; i < n; i++)
            if (!servos[i].turning)
                servos[i].middle = servos[i].moving ? x[i] : 0;
    }
    return 0;
}

typedef double vector __attribute__((vector_size(8 * WIDTH), aligned(8)));

/* Derivatives a step on, from how the velocities in its middle follow from `own`, `place` and `rate`. */
static inline __attribute__((always_inline)) void stepped(long n, long wide, const struct servo *servos, double h,
                                                          const double *inverse, const double *by_place,
                                                          const double *by_rate, const long *owner, const double *own,
                                                          double *place, double *rate)
{
    for (long block = 0; block < wide; block += WIDTH) {
        vector x[n];
#pragma GCC unroll 7
        for (long i = 0; i < n; i++)
            for (int k = 0; k < WIDTH; k++)
                x[i][k] = inverse[i * n + owner[block + k]] * own[block + k];
        for (long j = 0; j < n; j++) {
            vector p = *(vector *)(place + j * wide + block), v = *(vector *)(rate + j * wide + block);
#pragma GCC unroll 7
            for (long i = 0; i < n; i++)
                x[i] += by_place[i * n + j] * p + by_rate[i * n + j] * v;
        }
#pragma GCC unroll 7
        for (long i = 0; i < n; i++) {
            vector *p = (vector *)(place + i * wide + block), *v = (vector *)(rate + i * wide + block);
            *v = servos[i].moving ? 2 * x[i] - *v : 0 * x[i];
            *p += 2 * h * x[i];
        }
    }
}

/* Derivatives `place` and `rate` (joints, wide) of positions and velocities by the parameters, a step on: each has an
   `owner` among the joints, and changes its momentum by `own`. */
static void differentiated(long n, long wide, const struct servo *servos, double h, const double *m,
                           const double *factor, const long *owner, const double *own, double *place, double *rate)
{
    double inverse[n * n], by_rate[n * n], by_place[n * n];
    memset(inverse, 0, sizeof inverse);
    for (long j = 0; j < n; j++) {
        double x[n];
        for (long i = 0; i < n; i++)
            x[i] = i == j;
        if (!servos[j].moving)
            continue;
        if (m)
            solved(n, factor, x);
        else
            x[j] = 1 / servos[j].divisor;
        for (long i = 0; i < n; i++)
            inverse[i * n + j] = servos[i].moving ? x[i] : 0;
    }
    for (long j = 0; j < n; j++) {
        double along = servos[j].inertia + by_velocity(servos + j, h), pulled = -h * servos[j].passed * servos[j].acting;
        for (long i = 0; i < n; i++) {
            double sum = inverse[i * n + j] * along;
            for (long k = 0; m && k < n; k++)
                sum += k == j ? 0 : inverse[i * n + k] * m[k * n + j];
            by_rate[i * n + j] = sum;
            by_place[i * n + j] = inverse[i * n + j] * pulled;
        }
    }
    switch (n) { /* a number that the compiler knows keeps the sums of all joints in registers */
    case 1: stepped(1, wide, servos, h, inverse, by_place, by_rate, owner, own, place, rate); break;
    case 5: stepped(5, wide, servos, h, inverse, by_place, by_rate, owner, own, place, rate); break;
    case 6: stepped(6, wide, servos, h, inverse, by_place, by_rate, owner, own, place, rate); break;
    case 7: stepped(7, wide, servos, h, inverse, by_place, by_rate, owner, own, place, rate); break;
    default: stepped(n, wide, servos, h, inverse, by_place, by_rate, owner, own, place, rate);
    }
}

/* Paths (rows, lanes) with values (TERMS, lanes) on goals (rows + 1, lanes), `late` (lanes), and `slopes` (pieces, samples, joints, parameters):
   derivatives at the times `sample` (samples, pieces), in steps, by `parameters`, each a `term` of an `owner`
   among the joints; goals depend on a lane's own limit by `by_limit` (rows + 1, lanes).

   Lanes are the joints of `pieces` of motion, side by side. They move each other where there is inertia `between` them
   (every `thinned` rows, pieces, joints, joints), whose torque on each is written into `pull` (rows, lanes). What they
   touch (`lever` not NULL) has `clear` (rows, pieces) heights with all positions 0, levers (rows, lanes), hardness and
   damping `surface` (2, pieces); its forces go to `force` (rows, pieces), and are left out of the derivatives. */
void servo_roll_out(long rows, long pieces, long joints, double step, const double *values, const double *inertias,
                    const double *loads, const double *slopes_of_loads, const double *start, const double *goals,
                    const double *late, const double *between, long thinned, double *pull, const double *clear, const double *lever,
                    const double *surface, double *force, long parameters, const long *owner, const long *term,
                    const double *by_limit, long samples, const double *sample, double *path,
                    double *slopes)
{
    double h = 0.5 * step;
    long lanes = pieces * joints, square = joints * joints, wide = (parameters + WIDTH - 1) / WIDTH * WIDTH;
    long owners[wide + 1];
    double m[square], factor[square], terms[joints][TERMS], own[wide + 1], last[joints * wide + 1];
    struct servo *all = malloc(sizeof(struct servo) * SIDE_BY_SIDE * joints);
    double *derivatives = malloc(sizeof(double) * SIDE_BY_SIDE * 2 * (joints * wide + 1));
    double *before = malloc(sizeof(double) * 2 * (joints * wide + 1));
    memset(own, 0, sizeof own);
    for (long k = 0; k < wide; k++)
        owners[k] = k < parameters ? owner[k] : 0;
    for (long first = 0; first < pieces; first += SIDE_BY_SIDE) {
        long count = pieces - first < SIDE_BY_SIDE ? pieces - first : SIDE_BY_SIDE, nexts[SIDE_BY_SIDE] = {0};
        double forces[SIDE_BY_SIDE] = {0};
        memset(all, 0, sizeof(struct servo) * SIDE_BY_SIDE * joints);
        memset(derivatives, 0, sizeof(double) * SIDE_BY_SIDE * 2 * (joints * wide + 1));
        for (long i = 0; i < count * joints; i++) {
            for (int index = 0; index < TERMS; index++)
                all[i].p[index] = values[index * lanes + first * joints + i];
            all[i].position = start[first * joints + i];
        }
        for (long step_of_all = 0; step_of_all < rows * count; step_of_all++) {
            long row = step_of_all / count, number = step_of_all % count, piece = first + number;
            long line = row * lanes + piece * joints, next = nexts[number];
            struct servo *servos = all + number * joints;
            double *place = derivatives + number * 2 * joints * wide, *rate = place + joints * wide;
            double above = lever ? clear[row * pieces + piece] : 0, pressed = forces[number];
            for (long i = 0; i < joints; i++) {
                struct servo *s = servos + i;
                path[line + i] = s->position;
                begin(s, h, goals[line + i], goals[line + lanes + i], late[piece * joints + i], inertias[line + i], loads[line + i], slopes_of_loads[line + i]);
                above += lever ? lever[line + i] * s->position : 0;
            }
            if (between) {
                const double *old = between + ((row / thinned) * pieces + piece) * square;
                double part = (double)(row % thinned) / thinned;
                for (long k = 0; k < square; k++)
                    m[k] = part > 0 ? old[k] + part * (old[k + pieces * square] - old[k]) : old[k];
            }
            int settled = between && !lever && solved_together(joints, servos, h, m, factor);
            for (int sweep = 0; sweep < SWEEPS && !settled; sweep++) {
                double change =
                    swept(joints, servos, h, between ? m : NULL, lever ? lever + line : NULL, lever ? pressed : 0);
                if (lever) {
                    double hard = surface[piece], damping = surface[pieces + piece], speed = 0, give = 0, old = pressed;
                    for (long i = 0; i < joints; i++) {
                        double arm = lever[line + i];
                        speed += arm * servos[i].middle;
                        give += servos[i].moving ? arm * arm * h / servos[i].divisor : 0;
                    }
                    double lacking = -hard * (above + h * speed) - damping * speed - pressed;
                    pressed = larger(pressed + lacking / (1 + (h * hard + damping) * give), 0);
                    change = larger(change, fabs(pressed - old));
                }
                settled = change < SETTLED || !(between || lever);
            }
            if (force)
                force[row * pieces + piece] = forces[number] = pressed;
            for (long i = 0; between && i < joints; i++) {
                double sum = 0;
                for (long j = 0; j < joints; j++)
                    sum += j == i ? 0 : m[i * joints + j] * (servos[j].middle - servos[j].velocity);
                pull[line + i] = sum / h;
            }
            int turning = 0, turns[joints];
            for (long i = 0; i < joints; i++) {
                struct servo *s = servos + i;
                s->after = s->moving ? 2 * s->middle - s->velocity : 0;
                turning |= turns[i] = s->turning;
                if (turns[i]) /* derivatives begin without the turn */
                    s->middle = 0.5 * (s->velocity + s->turn[0]);
                s->turning = 0;
            }
            if (parameters) {
                if (between)
                    factored(joints, servos, m, factor);
                if (turning)
                    memcpy(before, place, sizeof(double) * 2 * joints * wide);
                for (long i = 0; i < joints; i++)
                    by_terms(servos + i, h, 1 / step, by_limit ? by_limit[line + i] : 0,
                             by_limit ? by_limit[line + lanes + i] : 0, slopes_of_loads[line + i], terms[i]);
                for (long k = 0; k < parameters; k++)
                    own[k] = terms[owner[k]][term[k]];
                if (next < samples && (sample[next * pieces + piece] < row + 1 || row > rows - 3))
                    memcpy(last, place, sizeof(double) * joints * wide);
                differentiated(joints, wide, servos, h, between ? m : NULL, factor, owners, own, place, rate);
                for (long i = 0; turning && i < joints; i++)
                    if (turns[i]) {
                        double friction[TERMS], resists[TERMS];
                        int mine[wide];
                        for (long k = 0; k < parameters; k++)
                            mine[k] = owner[k] == i;
                        turn_by_terms(servos + i, h, 1 / step, by_limit ? by_limit[line + i] : 0,
                                      by_limit ? by_limit[line + lanes + i] : 0, friction, resists);
                        turn_differentiated(servos + i, h, friction, resists, parameters, mine, term, before + i * wide,
                                            joints * wide, place + i * wide, rate + i * wide);
                    }
                for (; next < samples && (sample[next * pieces + piece] < row + 1 || row > rows - 3); next++) {
                    double part = sample[next * pieces + piece] - row;
                    double *to = slopes + (piece * samples + next) * joints * parameters;
                    for (long i = 0; i < joints; i++)
                        for (long k = 0; k < parameters; k++)
                            to[i * parameters + k] = last[i * wide + k] + part * (place[i * wide + k] - last[i * wide + k]);
                }
                nexts[number] = next;
            }
            for (long i = 0; i < joints; i++) {
                struct servo *s = servos + i;
                s->velocity = s->after;
                s->position += step * s->gone;
            }
        }
    }
    free(all);
    free(derivatives);
    free(before);
}
