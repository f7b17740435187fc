/* Roll-outs of servo joints (ident/servo/rollout.py, whose NumPy code computes the same): lanes are columns. */
#include <math.h>
#include <string.h>

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

enum { SWEEPS = 200 };
static const double SETTLED = 1e-9; /* [rad/s or N] change of a sweep at which the joints of a step agree */

struct servo {
    double p[TERMS], position, velocity, middle, torque, acting, inertia, momentum, friction, per_torque, faded, share,
        push, side, against, divisor, fading, loaded, left;
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
    s->torque = fmin(fmax(linear, -p[TORQUE_LIMIT]), p[TORQUE_LIMIT]);
    s->acting = s->outside && s->torque == linear ? p[STIFFNESS] : 0;
    s->inertia = p[ARMATURE] + inertia;
    s->momentum = s->inertia * s->velocity + h * (s->torque - load - p[ZERO] * slope);
    s->share = s->velocity / p[STRIBECK_VELOCITY];
    s->faded = exp(-s->share * s->share);
    double loaded = fabs(s->torque), breakaway = p[BREAKAWAY] + p[LOAD_BREAKAWAY] * loaded;
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
    double passed = fmax(1 - s->against * sign(s->torque) * s->per_torque, 0);
    s->divisor = s->inertia + h * s->p[DAMPING] + h * h * s->acting * passed;
    s->middle = s->moving ? (momentum - s->against * s->friction) / s->divisor : 0;
    return fabs(s->middle - before);
}

/* What the derivatives of all terms need of a step. */
static void end(struct servo *s, double h)
{
    s->left = s->torque - h * s->acting * s->middle;
    s->loaded = sign(s->torque) * s->left;
    double breakaway = s->p[BREAKAWAY] + s->p[LOAD_BREAKAWAY] * s->loaded;
    s->fading = h * breakaway * s->faded * 2 * s->share; /* by the logarithm of the velocity where it fades: × share */
}

/* How the momentum in the middle of a step changes with a term, from changes of the position and velocity before it;
   `own` where the term is this joint's, with the goal's change. */
static double changed(const struct servo *s, double h, int own, long term, double d_goal, double slope,
                      double d_position, double d_velocity)
{
    const double *p = s->p;
    double d_torque = -s->acting * d_position, d_friction = -s->fading / p[STRIBECK_VELOCITY] * d_velocity, push = 0;
    double passed = fmax(1 - s->against * sign(s->torque) * s->per_torque, 0);
    if (own) {
        d_torque += s->acting * d_goal;
        switch (term) {
        case STIFFNESS: d_torque += s->acting > 0 ? s->left : 0; break;
        case DAMPING: push = -h * p[DAMPING] * s->middle; break;
        case ARMATURE: push = p[ARMATURE] * (s->velocity - s->middle); break;
        case COULOMB: d_friction += h * p[COULOMB]; break;
        case BIAS: d_torque -= s->acting; break;
        case LOAD_FRICTION: d_friction += h * p[LOAD_FRICTION] * s->loaded; break;
        case ZERO: push = -h * slope; break;
        case BREAKAWAY: d_friction += h * p[BREAKAWAY] * s->faded; break;
        case LOAD_BREAKAWAY: d_friction += h * p[LOAD_BREAKAWAY] * s->loaded * s->faded; break;
        case STRIBECK_VELOCITY: d_friction += s->fading * s->share; break;
        case TORQUE_LIMIT: d_torque += s->outside && !(s->acting > 0) ? s->torque : 0; break;
        case DEAD_BAND: d_torque -= s->acting * s->side * p[DEAD_BAND]; break;
        }
    }
    return s->inertia * d_velocity + h * passed * d_torque + push - s->against * d_friction;
}

/* The lower triangle of a positive definite matrix (n, n) becomes its Cholesky factor. */
static void factored(long n, double *a)
{
    for (long i = 0; i < n; i++)
        for (long j = 0; j <= i; j++) {
            double sum = a[i * n + j];
            for (long k = 0; k < j; k++)
                sum -= a[i * n + k] * a[j * n + k];
            a[i * n + j] = i == j ? sqrt(fmax(sum, 1e-300)) : sum / a[j * n + j];
        }
}

static void solved(long n, const double *factor, double *x)
{
    for (long i = 0; i < n; i++) {
        for (long k = 0; k < i; k++)
            x[i] -= factor[i * n + k] * x[k];
        x[i] /= factor[i * n + i];
    }
    for (long i = n - 1; i >= 0; i--) {
        for (long k = i + 1; k < n; k++)
            x[i] -= factor[k * n + i] * x[k];
        x[i] /= factor[i * n + i];
    }
}

/* Paths (rows, lanes), and derivatives by the terms `term` (free): of goals (rows, lanes), which depend on the free
   terms by `d_goals` (free, rows, lanes), with values (TERMS, lanes).

   Lanes are the joints of `pieces` of motion, side by side. They move each other where there is inertia `between` them
   (every `thinned` rows, pieces, joints, joints), whose torque on each is written into `pull` (rows, lanes); the
   derivatives (joints, free, rows, lanes) are then by the terms of each of a piece's joints in turn, else (free, rows,
   lanes) by each lane's own. What they touch (`lever` not NULL) has `clear` (rows, pieces) heights with all positions
   0, levers (rows, lanes), hardness and damping `surface` (2, pieces); its forces go to `force` (rows, pieces), and are
   left out of the derivatives. */
void servo_roll_out(long rows, long pieces, long joints, double step, const double *values, const double *inertias,
                    const double *loads, const double *slopes, const double *start, const double *goals,
                    const double *between, long thinned, double *pull, const double *clear, const double *lever,
                    const double *surface, double *force, long free, const long *term, const double *d_goals,
                    double *path, double *tangents)
{
    double h = 0.5 * step;
    long lanes = pieces * joints, owners = between ? joints : 1, all = owners * free, square = joints * joints;
    double d_position[all * joints + 1], d_velocity[all * joints + 1], m[square], factor[square], change_of[joints];
    struct servo servos[joints];
    for (long piece = 0; piece < pieces; piece++) {
        long first = piece * joints;
        double pressed = 0;
        memset(servos, 0, sizeof servos);
        memset(d_position, 0, sizeof d_position);
        memset(d_velocity, 0, sizeof d_velocity);
        for (long i = 0; i < joints; i++) {
            for (int index = 0; index < TERMS; index++)
                servos[i].p[index] = values[index * lanes + first + i];
            servos[i].position = start[first + i];
        }
        for (long row = 0; row < rows; row++) {
            long line = row * lanes + first;
            double above = lever ? clear[row * pieces + piece] : 0;
            for (long i = 0; i < joints; i++) {
                struct servo *s = servos + i;
                path[line + i] = s->position;
                begin(s, h, goals[line + i], inertias[line + i], loads[line + i], slopes[line + i]);
                above += lever ? lever[line + i] * s->position : 0;
            }
            if (between) {
                const double *old = between + ((row / thinned) * pieces + piece) * square;
                double part = (double)(row % thinned) / thinned;
                for (long k = 0; k < square; k++)
                    m[k] = part > 0 ? old[k] + part * (old[k + pieces * square] - old[k]) : old[k];
            }
            double change = 0;
            for (int sweep = 0; sweep < SWEEPS; sweep++) {
                change = 0;
                for (long i = 0; i < joints; i++) {
                    double push = lever ? h * lever[line + i] * pressed : 0;
                    for (long j = 0; between && j < joints; j++)
                        push += j == i ? 0 : m[i * joints + j] * (servos[j].velocity - servos[j].middle);
                    servos[i].push = push;
                    change = fmax(change, move(servos + i, h));
                }
                if (lever) {
                    double hard = surface[piece], damping = surface[pieces + piece], rate = 0, give = 0, last = pressed;
                    for (long i = 0; i < joints; i++) {
                        double arm = lever[line + i];
                        rate += arm * servos[i].middle;
                        give += servos[i].moving ? arm * arm * h / servos[i].divisor : 0;
                    }
                    double lacking = -hard * (above + h * rate) - damping * rate - pressed;
                    pressed = fmax(pressed + lacking / (1 + (h * hard + damping) * give), 0);
                    change = fmax(change, fabs(pressed - last));
                }
                if (change < SETTLED || !(between || lever))
                    break;
            }
            if (force)
                force[row * pieces + piece] = pressed;
            if (between) {
                for (long i = 0; i < joints; i++) {
                    double sum = 0;
                    for (long j = 0; j < joints; j++)
                        sum += j == i ? 0 : m[i * joints + j] * (servos[j].middle - servos[j].velocity);
                    pull[line + i] = sum / h;
                }
            }
            if (free)
                for (long i = 0; i < joints; i++)
                    end(servos + i, h);
            if (free && between) {
                for (long i = 0; i < joints; i++)
                    for (long j = 0; j <= i; j++)
                        factor[i * joints + j] = i == j ? servos[i].divisor
                                                 : servos[i].moving && servos[j].moving ? m[i * joints + j] : 0;
                factored(joints, factor);
            }
            for (long f = 0; f < all; f++) {
                double *place = d_position + f * joints, *rate = d_velocity + f * joints;
                for (long i = 0; i < joints; i++) {
                    const struct servo *s = servos + i;
                    int own = !between || f / free == i;
                    tangents[f * rows * lanes + line + i] = place[i];
                    change_of[i] = 0;
                    if (!s->moving)
                        continue;
                    double d_goal = own ? d_goals[(f % free) * rows * lanes + line + i] : 0;
                    change_of[i] = changed(s, h, own, term[f % free], d_goal, slopes[line + i], place[i], rate[i]);
                    for (long j = 0; between && j < joints; j++)
                        change_of[i] += j == i ? 0 : m[i * joints + j] * rate[j];
                }
                if (between)
                    solved(joints, factor, change_of);
                for (long i = 0; i < joints; i++) {
                    double middle = between ? change_of[i] : servos[i].moving ? change_of[i] / servos[i].divisor : 0;
                    rate[i] = servos[i].moving ? 2 * middle - rate[i] : 0;
                    place[i] += step * middle;
                }
            }
            for (long i = 0; i < joints; i++) {
                struct servo *s = servos + i;
                s->velocity = s->moving ? 2 * s->middle - s->velocity : 0;
                s->position += step * s->middle;
            }
        }
    }
}
