/* Roll-outs of servo joints (ident/servo/rollout/numpy_rollout.py and goals.py compute the same): lanes are columns. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* The order of TERMS in ident/servo/terms.py. */
enum { STIFFNESS, DAMPING, ARMATURE, COULOMB, BIAS, DELAY, ACCELERATION_LIMIT, LOAD_FRICTION, ZERO, BREAKAWAY,
       LOAD_BREAKAWAY, STRIBECK_VELOCITY, TORQUE_LIMIT, DEAD_BAND, BACKLASH, TERMS };

enum { WIDTH = 8 }; /* lanes side by side */

typedef double vector __attribute__((vector_size(8 * WIDTH), aligned(8)));
typedef int64_t mask __attribute__((vector_size(8 * WIDTH), aligned(8)));

static inline vector every(double value) { return value - (vector){}; }
static inline vector pick(mask which, vector a, vector b) { return (vector)((which & (mask)a) | (~which & (mask)b)); }
static inline vector larger(vector a, vector b) { return pick(a > b, a, b); }
static inline vector smaller(vector a, vector b) { return pick(a < b, a, b); }
static inline vector size(vector a) { return (vector)((mask)a & INT64_MAX); }
static inline vector sign(vector a) { return pick(a > 0, every(1), pick(a < 0, every(-1), every(0))); }

static inline int any(mask which)
{
    int64_t found = 0;
    for (int l = 0; l < WIDTH; l++)
        found |= which[l];
    return found != 0;
}

static inline vector root(vector a)
{
    for (int l = 0; l < WIDTH; l++)
        a[l] = sqrt(a[l]);
    return a;
}

/* goals (rows, WIDTH) of profiles at each time of `count` lanes of commands (rows, lanes), with accelerations (WIDTH). */
static void profiles(long rows, long lanes, long count, double step, const double *command, const double *limit,
                     double *goals)
{
    vector goal = {0}, pace = {0}, limits = *(const vector *)limit, half = 0.5 * step * limits, most = step * limits;
    for (long l = 0; l < count; l++)
        goal[l] = command[l];
    vector target = *(vector *)goals = goal;
    for (long row = 1; row < rows; row++) {
        if (count == WIDTH)
            target = *(const vector *)(command + row * lanes);
        for (long l = 0; l < count && count < WIDTH; l++)
            target[l] = command[row * lanes + l];
        vector ahead = target - goal, distance = size(ahead);
        vector braking = smaller(root(2 * limits * distance + half * half) - half, distance / step);
        braking = pick(ahead < 0, -braking, braking); /* never past the target in one step */
        pace = smaller(larger(braking, pace - most), pace + most);
        goal += step * pace;
        /* a sum of velocities after their steps is half a step ahead */
        *(vector *)(goals + row * WIDTH) = goal - 0.5 * step * pace;
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

enum { SWEEPS = 200, PATTERNS = 6, GROUPS = 8 }; /* groups of lanes: memory is read row after row */
static const double SETTLED = 1e-9; /* [rad/s or N] change of a sweep at which the joints of a step agree */
static const double BEHIND = 0.2; /* share of the Coulomb friction behind the play, on the joint's side */

/* A joint in each of the pieces that are side by side. */
struct servo {
    vector p[TERMS], position, velocity, middle, torque, toward, acting, shares[2], limited, sided, later, inertia,
        momentum, friction, per_torque, faded, share, push, against, passed, divisor, gone, after, turn[3];
    mask moving, turning;
    /* with play: by how much the motor is ahead, its velocity, both after the step; the torque and load at its start */
    vector ahead, rate, next_ahead, next_rate, drive, load, travel;
    int play;
};

/* Pieces side by side. */
struct group {
    struct servo *servos;
    vector *old_place, *place, pressed, hard, damping;
    long piece[WIDTH], next[WIDTH], (*at)[WIDTH];
    int tight;
};

/* Half a step of a joint on its own, without what other joints and a contact add to its momentum. The goal is the first
   for the `late` share of the step, and then the other: a limit holds for each, not for their mean. */
static void begin(struct servo *s, double h, const vector *goals, vector late, vector inertia, vector load, vector slope)
{
    const vector *p = s->p, parts[2] = {late, 1 - late}, none = {0};
    vector middle = s->position + h * s->velocity + p[BIAS], torques[2];
    s->torque = s->limited = s->sided = none;
    for (int k = 0; k < 2; k++) {
        vector error = goals[k] - middle, side = sign(error), outside = size(error) - p[DEAD_BAND];
        vector linear = p[STIFFNESS] * side * larger(outside, none);
        torques[k] = smaller(larger(linear, -p[TORQUE_LIMIT]), p[TORQUE_LIMIT]);
        s->shares[k] = pick((outside > 0) & (torques[k] == linear), parts[k] * p[STIFFNESS], none);
        s->torque += parts[k] * torques[k];
        s->limited += pick(torques[k] == linear, none, parts[k] * torques[k]);
        s->sided += s->shares[k] * side;
    }
    s->acting = s->shares[0] + s->shares[1];
    s->later = torques[0] - torques[1];
    s->toward = sign(s->torque);
    s->drive = s->torque, s->load = load + p[ZERO] * slope;
    s->torque += h * s->acting * s->velocity; /* as at the beginning, from where the step is implicit */
    s->inertia = p[ARMATURE] + inertia;
    s->momentum = s->inertia * s->velocity + h * (s->torque - s->load);
    s->share = s->velocity / p[STRIBECK_VELOCITY];
    vector loaded = s->toward * s->torque, breakaway = p[BREAKAWAY] + p[LOAD_BREAKAWAY] * loaded;
    s->faded = none;
    if (any(breakaway > 0))
        for (int l = 0; l < WIDTH; l++)
            s->faded[l] = breakaway[l] > 0 ? exp(-s->share[l] * s->share[l]) : 0;
    s->friction = h * (p[COULOMB] + p[LOAD_FRICTION] * loaded + breakaway * s->faded);
    s->per_torque = p[LOAD_FRICTION] + p[LOAD_BREAKAWAY] * s->faded;
    s->push = none;
}

/* Where a joint comes to rest within a step, friction reverses with it, or holds it there from then on. `turn` is its
   velocity after the step if friction had not turned, half of its fall, and the share that it moves back with. */
static void turned(struct servo *s)
{
    s->turn[0] = 2 * s->middle - s->velocity;
    s->turn[1] = s->velocity - s->middle;
    s->turn[2] = larger(1 - 2 * s->friction / (size(s->turn[1]) * s->divisor), every(0));
    vector back = s->turn[2] * s->turn[0];
    s->middle = pick(s->turning, 0.5 * (s->velocity + back), s->middle);
    s->gone = pick(s->turning, (s->velocity * s->velocity - back * s->turn[0]) / (4 * s->turn[1]), s->gone);
}

/* The velocity in the middle of the step, with `push` in the momentum, of motor and joint as one body. */
static void move_joined(struct servo *s, double h)
{
    vector momentum = s->momentum + s->push, none = {0};
    mask going = s->velocity != 0;
    s->moving = going | (size(momentum) > s->friction);
    s->against = sign(pick(going, s->velocity, momentum));
    s->passed = larger(1 - s->against * s->toward * s->per_torque, none);
    s->divisor = s->inertia + h * s->p[DAMPING] + h * h * s->acting * s->passed;
    s->gone = s->middle = pick(s->moving, (momentum - s->against * s->friction) / s->divisor, none);
    s->turning = s->velocity * (2 * s->middle - s->velocity) < 0;
    if (any(s->turning))
        turned(s);
}

/* A body on its own through half a step. */
static void move_alone(struct servo *s, double h, vector inertia, vector velocity, vector force, vector friction)
{
    s->acting = s->per_torque = every(0);
    s->inertia = inertia, s->velocity = velocity;
    s->momentum = inertia * velocity + h * force, s->friction = h * larger(friction, every(0));
    move_joined(s, h);
}

/* The same of motor and joint with play between them: each on its own, unless the play would be used up in the step. Then
   they go on together, with their common velocity: the impact is plastic. */
static void move_loose(struct servo *s, double h)
{
    const vector *p = s->p, none = {0};
    vector half = 0.5 * p[BACKLASH], behind = BEHIND * p[COULOMB], apart = s->velocity - s->rate;
    struct servo motor = *s, link = *s;
    motor.push = link.p[DAMPING] = none;
    vector fading = s->rate / p[STRIBECK_VELOCITY], rubbing = p[BREAKAWAY] + p[LOAD_BREAKAWAY] * size(s->drive);
    for (int l = 0; l < WIDTH; l++)
        rubbing[l] *= exp(-fading[l] * fading[l]);
    move_alone(&motor, h, p[ARMATURE], s->rate, s->drive, p[COULOMB] - behind + p[LOAD_FRICTION] * size(s->drive) + rubbing);
    move_alone(&link, h, s->inertia - p[ARMATURE], s->velocity, -s->load, behind);
    vector ahead = s->ahead + 2 * h * (motor.gone - link.gone), end = pick(ahead < 0, -half, half);
    vector closing = (end - s->ahead) / (2 * h), momentum = s->momentum;
    mask loose = size(ahead) < half;
    s->momentum -= p[ARMATURE] * (apart + closing) + h * p[DAMPING] * closing;
    move_joined(s, h);
    s->momentum = momentum;
    vector after = s->middle + s->middle - s->velocity + p[ARMATURE] / s->inertia * (2 * closing + apart);
    after = pick(s->moving, after, none);
    s->middle = pick(loose, link.middle, 0.5 * (s->velocity + after));
    s->gone = pick(loose, link.gone, s->gone);
    s->moving = (loose & link.moving) | (~loose & s->moving);
    s->divisor = pick(loose, link.divisor, s->divisor);
    s->next_ahead = pick(loose, ahead, end);
    s->next_rate = pick(loose, pick(motor.moving, 2 * motor.middle - s->rate, none), after);
}

/* The velocity in the middle of the step, with `push` in the momentum; returns by how much it changed. */
static vector move(struct servo *s, double h)
{
    vector before = s->middle;
    if (s->play)
        move_loose(s, h);
    else
        move_joined(s, h);
    return size(s->middle - before);
}

/* How the momentum in the middle of a step changes with each of the joint's own terms (TERMS). */
static void by_terms(const struct servo *s, double h, double by_delay, const vector *by_limit, vector slope, vector *own)
{
    const vector *p = s->p;
    vector left = s->torque - h * s->acting * s->middle, loaded = s->toward * left, push = h * s->passed;
    vector drag = -s->against * h;
    own[STIFFNESS] = push * (left - s->limited);
    own[DAMPING] = -h * p[DAMPING] * s->middle;
    own[ARMATURE] = p[ARMATURE] * (s->velocity - s->middle);
    own[COULOMB] = drag * p[COULOMB];
    own[BIAS] = -push * s->acting;
    own[DELAY] = push * s->later * by_delay;
    own[ACCELERATION_LIMIT] = push * (s->shares[0] * by_limit[0] + s->shares[1] * by_limit[1]);
    own[LOAD_FRICTION] = drag * p[LOAD_FRICTION] * loaded;
    own[ZERO] = -h * slope;
    own[BREAKAWAY] = drag * p[BREAKAWAY] * s->faded;
    own[LOAD_BREAKAWAY] = drag * p[LOAD_BREAKAWAY] * loaded * s->faded;
    own[STRIBECK_VELOCITY] = drag * (p[BREAKAWAY] + p[LOAD_BREAKAWAY] * loaded) * s->faded * 2 * s->share * s->share;
    own[TORQUE_LIMIT] = push * s->limited;
    own[DEAD_BAND] = -push * s->sided * p[DEAD_BAND];
    own[BACKLASH] = every(0); /* its width is never searched by slopes */
}

/* How the momentum changes with the velocity before the step, beyond the inertia: friction that fades. */
static vector by_velocity(const struct servo *s, double h)
{
    vector loaded = s->toward * (s->torque - h * s->acting * s->middle);
    vector breakaway = s->p[BREAKAWAY] + s->p[LOAD_BREAKAWAY] * loaded;
    return s->against * h * breakaway * s->faded * 2 * s->share / s->p[STRIBECK_VELOCITY];
}

/* The Cholesky factor (n, n; below the diagonal, with its reciprocal) of what resists together the joints that move and
   do not turn. */
static void factored(long n, const struct servo *servos, const vector *m, vector *a)
{
    for (long i = 0; i < n; i++)
        for (long j = 0; j <= i; j++) {
            mask both = servos[i].moving & ~servos[i].turning & servos[j].moving & ~servos[j].turning;
            vector sum = pick(both, i == j ? servos[i].divisor : m[i * n + j], every(i == j));
            for (long k = 0; k < j; k++)
                sum -= a[i * n + k] * a[j * n + k];
            a[i * n + j] = i == j ? 1 / root(larger(sum, every(1e-300))) : sum * a[j * n + j];
        }
}

static void solved(long n, const vector *factor, vector *x)
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
static void turn_by_terms(const struct servo *s, double h, double by_delay, const vector *by_limit, vector *friction,
                          vector *resists)
{
    vector back[TERMS], bent = -h * h * s->acting * s->against * s->toward, none = {0};
    struct servo rest = *s;
    rest.middle = none, rest.against = every(1), rest.passed = 1 - s->toward * s->per_torque;
    by_terms(&rest, h, by_delay, by_limit, none, friction);
    rest.against = every(-1), rest.passed = 1 + s->toward * s->per_torque;
    by_terms(&rest, h, by_delay, by_limit, none, back);
    for (int index = 0; index < TERMS; index++) {
        friction[index] = 0.5 * (back[index] - friction[index]);
        resists[index] = none;
    }
    resists[STIFFNESS] = h * h * s->acting * s->passed;
    resists[DAMPING] = h * s->p[DAMPING];
    resists[ARMATURE] = s->p[ARMATURE];
    resists[LOAD_FRICTION] = bent * s->p[LOAD_FRICTION];
    resists[LOAD_BREAKAWAY] = bent * s->p[LOAD_BREAKAWAY] * s->faded;
}

/* Derivatives of a joint's `place` and `rate` where it turns, from those without the turn, and from those before the
   step, `old_place` and `old_rate`; friction and resistance change with its own terms by so much. */
static void turn_differentiated(const struct servo *s, double h, mask turns, const vector *friction,
                                const vector *resists, long joint, long parameters, const long *owner, const long *term,
                                const vector *old_place, const vector *old_rate, vector *place, vector *rate)
{
    struct servo still = *s;
    still.middle = every(0);
    vector by_place = -h * s->per_torque * s->toward * s->acting, by_rate = -s->against * by_velocity(&still, h);
    vector without = s->turn[0], half = s->turn[1], back = s->turn[2], fall = size(half) * s->divisor;
    for (long k = 0; k < parameters; k++) {
        vector v = old_rate[k], w = rate[k], u = 0.5 * (v - w);
        vector rubs = by_place * old_place[k] + by_rate * v, falls = s->against * u * s->divisor;
        if (owner[k] == joint)
            rubs += friction[term[k]], falls += size(half) * resists[term[k]];
        vector backs = pick(back > 0, 2 * (s->friction * falls / fall - rubs) / fall, every(0));
        vector squares = 2 * s->velocity * v - without * without * backs - 2 * back * without * w;
        rate[k] = pick(turns, back * w + without * backs, w);
        place[k] = pick(turns, old_place[k] + 2 * h * (squares / (4 * half) - s->gone * u / half), place[k]);
    }
}

/* One round over the joints, each with the others as they are; returns the largest change of a velocity. */
static vector swept(long n, struct servo *servos, double h, const vector *m, const vector *lever, vector pressed)
{
    vector change = {0};
    for (long i = 0; i < n; i++) {
        vector push = lever ? h * lever[i] * pressed : every(0);
        for (long j = 0; m && j < n; j++)
            push += j == i ? every(0) : m[i * n + j] * (servos[j].velocity - servos[j].middle);
        servos[i].push = push;
        change = larger(change, move(servos + i, h));
    }
    return change;
}

/* Velocities of joints that move each other, from which of them move, and where to, until that is right. */
static int solved_together(long n, struct servo *servos, double h, const vector *m, vector *factor)
{
    vector x[n];
    mask right = {0};
    for (long i = 0; i < n; i++)
        if (servos[i].play)
            return 0;
    for (int attempt = 0; attempt < PATTERNS; attempt++) {
        mask same = every(attempt) > 0;
        for (long i = 0; i < n; i++) {
            mask moving = servos[i].moving, turning = servos[i].turning;
            vector against = servos[i].against, push = {0};
            for (long j = 0; j < n; j++)
                push += j == i ? every(0) : m[i * n + j] * (servos[j].velocity - servos[j].middle);
            servos[i].push = push;
            vector change = move(servos + i, h);
            same &= (moving == servos[i].moving) & (~moving | (against == servos[i].against));
            same &= (turning == servos[i].turning) & (~turning | (change < SETTLED));
        }
        right |= same;
        if (!any(~right))
            return 1;
        factored(n, servos, m, factor);
        for (long i = 0; i < n; i++) {
            x[i] = every(0);
            for (long j = 0; j < n; j++)
                x[i] += j == i ? every(0) : m[i * n + j] * (servos[j].velocity - pick(servos[j].turning, servos[j].middle, every(0)));
            x[i] += servos[i].momentum - servos[i].against * servos[i].friction;
            x[i] = pick(servos[i].moving & ~servos[i].turning, x[i], every(0));
        }
        solved(n, factor, x);
        for (long i = 0; i < n; i++)
            servos[i].middle = pick(servos[i].turning, servos[i].middle, pick(servos[i].moving, x[i], every(0)));
    }
    return 0;
}

/* Derivatives a step on, from how the velocities in its middle follow from `terms`, place and rate. */
static inline __attribute__((always_inline)) void stepped(long n, const struct servo *servos, double h,
                                                          const vector *inverse, const vector *by_place,
                                                          const vector *by_rate, long parameters, const long *owner,
                                                          const long *term, const vector (*terms)[TERMS],
                                                          const vector *old_place, const vector *old_rate,
                                                          vector *place, vector *rate)
{
    for (long k = 0; k < parameters; k++) {
        vector x[n], own = terms[owner[k]][term[k]];
#pragma GCC unroll 7
        for (long i = 0; i < n; i++)
            x[i] = inverse[i * n + owner[k]] * own;
        for (long j = 0; j < n; j++) {
            vector p = old_place[j * parameters + k], v = old_rate[j * parameters + k];
#pragma GCC unroll 7
            for (long i = 0; i < n; i++)
                x[i] += by_place[i * n + j] * p + by_rate[i * n + j] * v;
        }
#pragma GCC unroll 7
        for (long i = 0; i < n; i++) {
            rate[i * parameters + k] = pick(servos[i].moving, 2 * x[i] - old_rate[i * parameters + k], every(0));
            place[i * parameters + k] = old_place[i * parameters + k] + 2 * h * x[i];
        }
    }
}

/* Derivatives `place` and `rate` (joints, parameters) of positions and velocities a step on: each parameter has an
   `owner` among the joints, and changes its momentum by its `term` of `terms`. */
static void differentiated(long n, const struct servo *servos, double h, const vector *m, const vector *factor,
                           long parameters, const long *owner, const long *term, const vector (*terms)[TERMS],
                           const vector *old_place, const vector *old_rate, vector *place, vector *rate)
{
    vector inverse[n * n], by_rate[n * n], by_place[n * n];
    for (long j = 0; j < n; j++) {
        vector x[n];
        for (long i = 0; i < n; i++)
            x[i] = every(i == j);
        if (m)
            solved(n, factor, x);
        else
            x[j] = 1 / servos[j].divisor;
        for (long i = 0; i < n; i++)
            inverse[i * n + j] = pick(servos[i].moving & servos[j].moving, x[i], every(0));
    }
    for (long j = 0; j < n; j++) {
        vector along = servos[j].inertia + by_velocity(servos + j, h), pulled = -h * servos[j].passed * servos[j].acting;
        for (long i = 0; i < n; i++) {
            vector sum = inverse[i * n + j] * along;
            for (long k = 0; m && k < n; k++)
                sum += k == j ? every(0) : inverse[i * n + k] * m[k * n + j];
            by_rate[i * n + j] = sum;
            by_place[i * n + j] = inverse[i * n + j] * pulled;
        }
    }
#define STEPPED(count) stepped(count, servos, h, inverse, by_place, by_rate, parameters, owner, term, terms, old_place, old_rate, place, rate)
    switch (n) { /* a number that the compiler knows keeps the sums of all joints in registers */
    case 1: STEPPED(1); break;
    case 5: STEPPED(5); break;
    case 6: STEPPED(6); break;
    case 7: STEPPED(7); break;
    default: STEPPED(n);
    }
#undef STEPPED
}

/* The values of a row at places `at`, which are next to each other where they are `tight`. */
static inline vector gathered(const double *row, const long *at, int tight)
{
    vector found;
    if (tight)
        return *(const vector *)(row + at[0]);
    for (int l = 0; l < WIDTH; l++)
        found[l] = row[at[l]];
    return found;
}

static inline void scattered(vector values, double *row, const long *at, int tight)
{
    if (tight)
        *(vector *)(row + at[0]) = values;
    for (int l = 0; l < WIDTH && !tight; l++)
        row[at[l]] = values[l];
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
    long lanes = pieces * joints, square = joints * joints, many = joints * parameters;
    long most = between ? 1 : GROUPS;
    vector m[square], old[square], risen[square], factor[square], terms[joints][TERMS], arms[joints];
    struct servo *all = aligned_alloc(sizeof(vector), sizeof(struct servo) * joints * most);
    vector *buffer = aligned_alloc(sizeof(vector), sizeof(vector) * (4 * many * most + 1));
    long places[most][joints][WIDTH];
    struct group groups[most];
    for (long begun = 0; begun < pieces; begun += most * WIDTH) {
        long count = 0;
        memset(all, 0, sizeof(struct servo) * joints * most);
        for (long first = begun; first < pieces && count < most; first += WIDTH, count++) {
            vector *own = buffer + 4 * many * count, none = {0};
            struct group g = {all + joints * count, own, own + 2 * many, none, none, none, {0}, {0}, places[count], joints == 1 && first + WIDTH <= pieces};
            memset(own, 0, sizeof(vector) * 2 * many);
            for (long l = 0; l < WIDTH; l++) { /* the last piece fills the last group up */
                g.piece[l] = first + l < pieces ? first + l : pieces - 1;
                for (long i = 0; i < joints; i++)
                    g.at[i][l] = g.piece[l] * joints + i;
            }
            for (long i = 0; i < joints; i++) {
                for (int index = 0; index < TERMS; index++)
                    g.servos[i].p[index] = gathered(values + index * lanes, g.at[i], g.tight);
                g.servos[i].position = gathered(start, g.at[i], g.tight);
                g.servos[i].play = any(g.servos[i].p[BACKLASH] > 0);
                g.servos[i].ahead = 0.5 * g.servos[i].p[BACKLASH] * sign(gathered(loads, g.at[i], g.tight));
            }
            if (lever)
                g.hard = gathered(surface, g.piece, g.tight), g.damping = gathered(surface + pieces, g.piece, g.tight);
            groups[count] = g;
        }
        for (long step_of_all = 0; step_of_all < rows * count; step_of_all++) {
            struct group *g = groups + step_of_all % count;
            struct servo *servos = g->servos;
            long row = step_of_all / count, (*at)[WIDTH] = g->at, *piece = g->piece;
            int tight = g->tight;
            const long line = row * lanes;
            vector above = lever ? gathered(clear + row * pieces, piece, tight) : every(0), *old_place = g->old_place, *place = g->place, *old_rate = old_place + many, *rate = place + many;
            vector slope[joints];
            for (long i = 0; i < joints; i++) {
                struct servo *s = servos + i;
                vector both[2] = {gathered(goals + line, at[i], tight), gathered(goals + line + lanes, at[i], tight)};
                slope[i] = gathered(slopes_of_loads + line, at[i], tight);
                scattered(s->position, path + line, at[i], tight);
                begin(s, h, both, gathered(late, at[i], tight), gathered(inertias + line, at[i], tight), gathered(loads + line, at[i], tight), slope[i]);
                if (lever)
                    arms[i] = gathered(lever + line, at[i], tight), above += arms[i] * s->position;
            }
            for (long k = 0; k < square && between; k++) {
                if (row % thinned == 0)
                    for (int l = 0; l < WIDTH; l++) {
                        const double *now = between + ((row / thinned) * pieces + piece[l]) * square + k;
                        old[k][l] = now[0], risen[k][l] = now[pieces * square] - now[0];
                    }
                m[k] = old[k] + (double)(row % thinned) / thinned * risen[k];
            }
            int settled = between && !lever && solved_together(joints, servos, h, m, factor);
            for (int sweep = 0; sweep < SWEEPS && !settled; sweep++) {
                vector change = swept(joints, servos, h, between ? m : NULL, lever ? arms : NULL, g->pressed);
                if (lever) {
                    vector speed = {0}, give = {0}, last = g->pressed;
                    for (long i = 0; i < joints; i++) {
                        speed += arms[i] * servos[i].middle;
                        give += pick(servos[i].moving, arms[i] * arms[i] * h / servos[i].divisor, every(0));
                    }
                    vector lacking = -g->hard * (above + h * speed) - g->damping * speed - last;
                    g->pressed = larger(last + lacking / (1 + (h * g->hard + g->damping) * give), every(0));
                    change = larger(change, size(g->pressed - last));
                }
                settled = !(between || lever) || !any(~(change < SETTLED));
            }
            if (force)
                scattered(g->pressed, force + row * pieces, piece, tight);
            for (long i = 0; between && i < joints; i++) {
                vector sum = {0};
                for (long j = 0; j < joints; j++)
                    sum += j == i ? every(0) : m[i * joints + j] * (servos[j].middle - servos[j].velocity);
                scattered(sum / h, pull + line, at[i], tight);
            }
            mask turns[joints];
            for (long i = 0; i < joints; i++) {
                struct servo *s = servos + i;
                s->after = pick(s->moving, 2 * s->middle - s->velocity, every(0));
                vector gone = s->gone;
                if (s->play) { /* derivatives are those without play, which is used up again within a few steps */
                    s->ahead = s->next_ahead, s->rate = s->next_rate;
                    move_joined(s, h);
                }
                s->travel = gone;
                turns[i] = s->turning;
                /* derivatives begin without the turn */
                s->middle = pick(s->turning, 0.5 * (s->velocity + s->turn[0]), s->middle);
                s->turning = (mask){0};
            }
            if (parameters) {
                if (between)
                    factored(joints, servos, m, factor);
                vector limits[joints][2];
                for (long i = 0; i < joints; i++) {
                    for (int k = 0; k < 2; k++)
                        limits[i][k] = by_limit ? gathered(by_limit + line + k * lanes, at[i], tight) : every(0);
                    by_terms(servos + i, h, 1 / step, limits[i], slope[i], terms[i]);
                }
                differentiated(joints, servos, h, between ? m : NULL, factor, parameters, owner, term, terms, old_place, old_rate, place, rate);
                for (long i = 0; i < joints; i++)
                    if (any(turns[i])) {
                        vector friction[TERMS], resists[TERMS];
                        turn_by_terms(servos + i, h, 1 / step, limits[i], friction, resists);
                        turn_differentiated(servos + i, h, turns[i], friction, resists, i, parameters, owner, term, old_place + i * parameters,
                                            old_rate + i * parameters, place + i * parameters, rate + i * parameters);
                    }
                for (int due = 1; due;) {
                    vector part = {0};
                    double *to[WIDTH] = {0};
                    due = 0;
                    for (int l = 0; l < WIDTH; l++) {
                        long next = g->next[l];
                        if (next >= samples || !(sample[next * pieces + piece[l]] < row + 1 || row > rows - 3))
                            continue;
                        part[l] = sample[next * pieces + piece[l]] - row;
                        to[l] = slopes + (piece[l] * samples + next) * many;
                        g->next[l]++, due++;
                    }
                    for (long k = 0; k < many && due; k++) {
                        vector then = old_place[k] + part * (place[k] - old_place[k]);
                        for (int l = 0; l < WIDTH; l++)
                            if (to[l])
                                to[l][k] = then[l];
                    }
                }
                g->old_place = place, g->place = old_place;
            }
            for (long i = 0; i < joints; i++) {
                struct servo *s = servos + i;
                s->velocity = s->after;
                s->position += step * s->travel;
            }
        }
    }
    free(all);
    free(buffer);
}
