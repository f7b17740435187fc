/* Roll-outs of servo joints (ident/servo/rollout.py, whose NumPy code computes the same): lanes are columns. */
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

/* Means over each step of delayed goals (rows, lanes), of commands (history + rows, lanes), and their derivatives by
   the delay and, as a difference over ± `span`, by the logarithm of the limit, where they are not NULL. A limit of
   `unlimited` or more is none. */
void servo_goals(long history, long rows, long lanes, double step, double span, double unlimited,
                 const double *command, const double *delay, const double *limit, double *goals, double *by_delay,
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
            double late[WIDTH], older[WIDTH], newer[WIDTH];
            for (long l = 0; l < count; l++) {
                whole[l] = floor(delay[first + l] / step);
                late[l] = delay[first + l] / step - whole[l];
            }
            for (long row = -1; row < rows; row++) {
                for (long l = 0; l < count; l++) {
                    long place = history - whole[l] + row + 1;
                    place = place < 0 ? 0 : place > all - 1 ? all - 1 : place;
                    older[l] = newer[l];
                    newer[l] = !(steep[l] < unlimited) || !place
                                   ? command[place * lanes + first + l]
                                   : 0.5 * (block[place * WIDTH + l] + block[(place - 1) * WIDTH + l]);
                }
                for (long l = 0; row >= 0 && l < count; l++) {
                    long at = row * lanes + first + l;
                    double change = older[l] - newer[l], goal = newer[l] + late[l] * change;
                    if (variant)
                        by_limit[at] = variant == 1 ? goal : (by_limit[at] - goal) / (2 * span);
                    else
                        goals[at] = goal;
                    if (!variant && by_delay)
                        by_delay[at] = change / step;
                }
            }
        }
    }
    free(block);
}

enum { SWEEPS = 200, PATTERNS = 6, SIDE_BY_SIDE = 8 }; /* pieces: memory is read row after row */
static const double SETTLED = 1e-9; /* [rad/s or N] change of a sweep at which the joints of a step agree */

struct servo {
    double p[TERMS], position, velocity, middle, torque, acting, inertia, momentum, friction, per_torque, faded, share,
        push, side, against, passed, divisor;
    int outside, moving;
};

/* Half a step of a joint on its own, without what other joints and a contact add to its momentum. */
static void begin(struct servo *s, double h, double goal, double inertia, double load, double slope)
{
    const double *p = s->p;
    double error = goal - s->position - p[BIAS];
    s->side = sign(error);
    s->outside = fabs(error) > p[DEAD_BAND];
    double linear = s->outside ? p[STIFFNESS] * (error - s->side * p[DEAD_BAND]) : 0;
    s->torque = smaller(larger(linear, -p[TORQUE_LIMIT]), p[TORQUE_LIMIT]);
    s->acting = s->outside && s->torque == linear ? p[STIFFNESS] : 0;
    s->inertia = p[ARMATURE] + inertia;
    s->momentum = s->inertia * s->velocity + h * (s->torque - load - p[ZERO] * slope);
    s->share = s->velocity / p[STRIBECK_VELOCITY];
    double loaded = fabs(s->torque), breakaway = p[BREAKAWAY] + p[LOAD_BREAKAWAY] * loaded;
    s->faded = breakaway > 0 ? exp(-s->share * s->share) : 0;
    s->friction = h * (p[COULOMB] + p[LOAD_FRICTION] * loaded + breakaway * s->faded);
    s->per_torque = p[LOAD_FRICTION] + p[LOAD_BREAKAWAY] * s->faded;
    s->push = 0;
}

/* The velocity in the middle of the step, with `push` in the momentum; returns by how much it changed. */
static double move(struct servo *s, double h)
{
    double momentum = s->momentum + s->push, before = s->middle;
    s->moving = fabs(momentum) > s->friction;
    s->against = sign(momentum);
    s->passed = larger(1 - s->against * sign(s->torque) * s->per_torque, 0);
    s->divisor = s->inertia + h * s->p[DAMPING] + h * h * s->acting * s->passed;
    s->middle = s->moving ? (momentum - s->against * s->friction) / s->divisor : 0;
    return fabs(s->middle - before);
}

/* How the momentum in the middle of a step changes with each of the joint's own terms (TERMS). */
static void by_terms(const struct servo *s, double h, double by_delay, double by_limit, double slope, double *own)
{
    const double *p = s->p;
    double left = s->torque - h * s->acting * s->middle, loaded = sign(s->torque) * left, push = h * s->passed;
    double drag = -s->against * h;
    own[STIFFNESS] = s->acting > 0 ? push * left : 0;
    own[DAMPING] = -h * p[DAMPING] * s->middle;
    own[ARMATURE] = p[ARMATURE] * (s->velocity - s->middle);
    own[COULOMB] = drag * p[COULOMB];
    own[BIAS] = -push * s->acting;
    own[DELAY] = push * s->acting * by_delay;
    own[ACCELERATION_LIMIT] = push * s->acting * by_limit;
    own[LOAD_FRICTION] = drag * p[LOAD_FRICTION] * loaded;
    own[ZERO] = -h * slope;
    own[BREAKAWAY] = drag * p[BREAKAWAY] * s->faded;
    own[LOAD_BREAKAWAY] = drag * p[LOAD_BREAKAWAY] * loaded * s->faded;
    own[STRIBECK_VELOCITY] = drag * (p[BREAKAWAY] + p[LOAD_BREAKAWAY] * loaded) * s->faded * 2 * s->share * s->share;
    own[TORQUE_LIMIT] = s->outside && !(s->acting > 0) ? push * s->torque : 0;
    own[DEAD_BAND] = -push * s->acting * s->side * p[DEAD_BAND];
}

/* How the momentum changes with the velocity before the step, beyond the inertia: friction that fades. */
static double by_velocity(const struct servo *s, double h)
{
    double loaded = sign(s->torque) * (s->torque - h * s->acting * s->middle);
    double breakaway = s->p[BREAKAWAY] + s->p[LOAD_BREAKAWAY] * loaded;
    return s->against * h * breakaway * s->faded * 2 * s->share / s->p[STRIBECK_VELOCITY];
}

/* The Cholesky factor (n, n; below the diagonal, with its reciprocal) of what resists the moving joints together. */
static void factored(long n, const struct servo *servos, const double *m, double *a)
{
    for (long i = 0; i < n; i++)
        for (long j = 0; j <= i; j++) {
            double sum = servos[i].moving && servos[j].moving ? i == j ? servos[i].divisor : m[i * n + j] : i == j;
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
            int moving = servos[i].moving;
            double against = servos[i].against, push = 0;
            for (long j = 0; j < n; j++)
                push += j == i ? 0 : m[i * n + j] * (servos[j].velocity - servos[j].middle);
            servos[i].push = push;
            move(servos + i, h);
            same &= moving == servos[i].moving && (!moving || against == servos[i].against);
        }
        if (same)
            return 1;
        factored(n, servos, m, factor);
        for (long i = 0; i < n; i++) {
            x[i] = 0;
            for (long j = 0; servos[i].moving && j < n; j++)
                x[i] += j == i ? 0 : m[i * n + j] * servos[j].velocity;
            x[i] += servos[i].moving ? servos[i].momentum - servos[i].against * servos[i].friction : 0;
        }
        solved(n, factor, x);
        for (long i = 0; i < n; i++)
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

/* Paths (rows, lanes) with values (TERMS, lanes) on goals (rows, lanes), and `slopes` (pieces, samples, joints, parameters):
   derivatives at the times `sample` (samples, pieces), in steps, by `parameters`, each a `term` of an `owner`
   among the joints; goals depend on a lane's own delay and limit by `by_delay` and
   `by_limit` (rows, lanes).

   Lanes are the joints of `pieces` of motion, side by side. They move each other where there is inertia `between` them
   (every `thinned` rows, pieces, joints, joints), whose torque on each is written into `pull` (rows, lanes). What they
   touch (`lever` not NULL) has `clear` (rows, pieces) heights with all positions 0, levers (rows, lanes), hardness and
   damping `surface` (2, pieces); its forces go to `force` (rows, pieces), and are left out of the derivatives. */
void servo_roll_out(long rows, long pieces, long joints, double step, const double *values, const double *inertias,
                    const double *loads, const double *slopes_of_loads, const double *start, const double *goals,
                    const double *between, long thinned, double *pull, const double *clear, const double *lever,
                    const double *surface, double *force, long parameters, const long *owner, const long *term,
                    const double *by_delay, const double *by_limit, long samples, const double *sample, double *path,
                    double *slopes)
{
    double h = 0.5 * step;
    long lanes = pieces * joints, square = joints * joints, wide = (parameters + WIDTH - 1) / WIDTH * WIDTH;
    long owners[wide + 1];
    double m[square], factor[square], terms[joints][TERMS], own[wide + 1], last[joints * wide + 1];
    struct servo *all = malloc(sizeof(struct servo) * SIDE_BY_SIDE * joints);
    double *derivatives = malloc(sizeof(double) * SIDE_BY_SIDE * 2 * (joints * wide + 1));
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
                begin(s, h, goals[line + i], inertias[line + i], loads[line + i], slopes_of_loads[line + i]);
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
            if (parameters) {
                if (between)
                    factored(joints, servos, m, factor);
                for (long i = 0; i < joints; i++)
                    by_terms(servos + i, h, by_delay ? by_delay[line + i] : 0, by_limit ? by_limit[line + i] : 0,
                             slopes_of_loads[line + i], terms[i]);
                for (long k = 0; k < parameters; k++)
                    own[k] = terms[owner[k]][term[k]];
                if (next < samples && (sample[next * pieces + piece] < row + 1 || row > rows - 3))
                    memcpy(last, place, sizeof(double) * joints * wide);
                differentiated(joints, wide, servos, h, between ? m : NULL, factor, owners, own, place, rate);
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
                s->velocity = s->moving ? 2 * s->middle - s->velocity : 0;
                s->position += step * s->middle;
            }
        }
    }
    free(all);
    free(derivatives);
}
