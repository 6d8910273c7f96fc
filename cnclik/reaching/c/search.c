/* The search for targets. `native_source` writes `look` for a chain and a task, `Lanes`, which it reads and writes, N and
   the other constants. Lanes are vectors of W numbers. */
#include <string.h>

typedef struct { /* the result of a search for a target; `search.Found` in Python */
  double q[N], squares[2], cost, steep; /* the best posture and its squared errors; see `step.Search` */
  double looks, found;
  double places[PLACES][N], costs[PLACES]; /* the best places of tries that did not arrive */
} Found;

typedef struct { /* B targets; the same as `native._Call` */
  const double *pose, *near; /* (B, AIMS, 12), (B, N) or NULL */
  const uint8_t *skip; /* (B) or NULL: targets that are left out */
  Found *made; /* (B) */
  double *rows; /* (B, 2 N + 5) or NULL: for targets that are found, rows for `result.from_rows` */
  const double *low, *high; /* (N) range of the search, which `jump` narrows */
  const double *lower, *upper, *jump; /* (N) limits; INFINITY without a jump */
  const double *periods, *turns; /* (N) the turn after which a posture repeats, or 0; it where several turns fit */
  const double *postures, *middle, *width; /* of the seeds: (SETS * SIZE, N), (N), (N) */
  const float *features, *factors; /* (AIMS, SETS, 13, SIZE), (AIMS, 12) */
  const double *roots; /* (M) roots of the weights */
  double tolerance[2];
  int64_t done, tries, budget, seed; /* done: earlier tries; tries: all */
  int64_t downhill; /* steps from each kept place to the nearest pose; 0: tries from seeds */
} Asked;

typedef struct { /* the try of one lane */
  int64_t target, number; /* number: its index among the target's tries */
  int step, most;
  int bounded, free; /* whether its target has bounds; whether the try is free of them */
  double looks;
} Try;

typedef float F __attribute__((vector_size(BYTES)));
typedef int32_t J __attribute__((vector_size(BYTES)));
#define WF (BYTES / 4)
#define EITHER(mask, a, b) (((mask) & (J)(a)) | (~(mask) & (J)(b)))

/* The seed of a set whose tip is nearest to one of a target's aims. */
static const double *nearest(const Asked *a, int64_t target, int64_t aim, int64_t set)
{
  const float *features = a->features + (aim * SETS + set) * 13 * SIZE, *factors = a->factors + aim * 12;
  const double *pose = a->pose + (target * AIMS + aim) * 12;
  F shortest;
  J where, at;
  float asked[12], smallest = INFINITY;
  int64_t found = 0;
  memset(&shortest, 0, sizeof shortest);
  memset(&where, 0, sizeof where);
  memset(&at, 0, sizeof at);
  for (int i = 0; i < 12; ++i) asked[i] = (float)pose[i] * factors[i];
  for (int i = 0; i < WF; ++i) {
    shortest[i] = INFINITY;
    at[i] = i;
  }
  for (int k = 0; k < SIZE; k += WF) {
    F far, row;
    memcpy(&far, features + 12 * SIZE + k, sizeof far);
    for (int i = 0; i < 12; ++i) {
      memcpy(&row, features + i * SIZE + k, sizeof row);
      far = far + row * asked[i];
    }
    const J nearer = far < shortest;
    shortest = (F)EITHER(nearer, far, shortest);
    where = EITHER(nearer, at, where);
    at = at + WF;
  }
  for (int i = 0; i < WF; ++i) {
    if (shortest[i] < smallest) {
      smallest = shortest[i];
      found = where[i];
    }
  }
  return a->postures + (set * SIZE + found) * N;
}

/* A joint's value plus whole turns, as near to `about` as the bounds allow; as `seeds.turned`. */
static double turned(double q, double about, double period, double low, double high)
{
  const double few = ceil((low - q) / period), most = floor((high - q) / period), turns = rint((about - q) / period);
  if (!(period > 0 && few <= most)) return q;
  return q + period * (turns < few ? few : turns > most ? most : turns);
}

static double most(double a, double b) { return a > b ? a : b; }
static double least(double a, double b) { return a < b ? a : b; }

/* Set the range of the search for a lane's target; returns whether it is bounded. */
static int narrow(const Asked *a, Lanes *s, int64_t target, int i)
{
  int bounded = 0;
  for (int j = 0; j < N; ++j) { /* outside the limits: the bound nearest to `near` */
    const double about = a->jump[j] < INFINITY ? a->near[target * N + j] : 0;
    const double low = least(most(a->low[j], about - a->jump[j]), a->high[j]);
    s->high[j][i] = most(least(a->high[j], about + a->jump[j]), a->low[j]);
    s->low[j][i] = low;
    bounded |= low > -INFINITY || s->high[j][i] < INFINITY;
  }
  return bounded;
}

/* Set a lane to its state before the first step. */
static void fresh(Lanes *s, Try *own, int i, int steps)
{
  s->squares[0][i] = s->squares[1][i] = s->cost[i] = s->steep[i] = INFINITY;
  s->trust[i] = 1;
  s->arrived[i] = 0;
  own->step = 0;
  own->most = steps;
}

/* After a try without bounds has arrived: begin again within them, at the posture nearest to its answer. */
static void inward(const Asked *a, Lanes *s, Try *own, int i)
{
  narrow(a, s, own->target, i);
  for (int j = 0; j < N; ++j) {
    const double low = s->low[j][i], high = s->high[j][i], about = a->near == NULL ? 0 : a->near[own->target * N + j];
    const double q = turned(s->best[j][i], about, a->periods[j], low, high);
    s->q[j][i] = s->best[j][i] = q < low ? low : q > high ? high : q;
  }
  own->free = 0;
  fresh(s, own, i, CAREFUL);
}

/* Begin the next try of a lane's target; returns whether there is one. */
static int begin(const Asked *a, Lanes *s, Try *own, int i)
{
  const int64_t target = own->target;
  const Found *made = a->made + target;
  const int outer = own->bounded && !a->downhill;
  for (; a->downhill && own->number < PLACES && !(made->costs[own->number] < INFINITY); ++own->number) {}
  if (outer && own->number >= SETS && (a->seed + own->number) % (2 * OUTER) == 2 * OUTER - 1) own->number += 1;
  if (own->number >= a->tries || (own->number >= PLAIN && own->looks >= (double)a->budget)) return 0;
  const int64_t k = own->number, number = a->seed + k;
  if (own->free) narrow(a, s, target, i);
  own->free = outer && k >= SETS && number % OUTER == 2;
  const int plain = k < PLAIN && !a->downhill, by = plain && a->near != NULL;
  static const double stretches[] = {STRETCHED};
  static const int owners[N] = {OWNERS};
  const double stretch = k < SETS ? 1 : stretches[number % STRETCHES];
  const double *starts[AIMS], *place = NULL; /* start of the joints that an aim owns */
  for (int aim = 0; aim < AIMS; ++aim) {
    if (a->downhill) {
      starts[aim] = made->places[k];
    } else if (by) {
      starts[aim] = a->postures + number % (SETS * SIZE) * N;
    } else if (k < SETS) {
      starts[aim] = nearest(a, target, aim, number % SETS);
    } else {
      const uint32_t any = (uint32_t)number * SCATTER, some = (any >> 16) % PLACES;
      starts[aim] = a->postures + (any >> 20) % (SETS * SIZE) * N;
      place = number % SELDOM <= (AIMS > 1) && made->costs[some] < INFINITY ? made->places[some] : NULL;
    }
  }
  for (int j = 0; j < N; ++j) {
    const double low = s->low[j][i], high = s->high[j][i], width = a->width[j] > 1e-9 ? a->width[j] : 1e-9;
    const double start = starts[owners[j]][j], from = (start - a->middle[j]) / width;
    const double about = a->near == NULL ? 0 : a->near[target * N + j];
    double q = start;
    if (by) {
      q = turned(about + AROUND * (double)k / PLAIN * 2 * from, about, a->periods[j], low, high);
    } else if (place != NULL && AIMS == 1) {
      q = place[j] + q - a->middle[j];
    } else if (place != NULL && owners[j] != number / SELDOM % AIMS) { /* the other tips begin at the kept place */
      q = place[j];
    } else if (!a->downhill) { /* as `seeds.starts` */
      if (a->near != NULL) q = turned(q, about, a->periods[j], low, high);
      if (q < low || q > high || (stretch > 1 && high - low < INFINITY)) q = low + (high - low) * (stretch * from + 0.5);
    }
    q = q < low ? low : q > high ? high : q;
    s->q[j][i] = s->best[j][i] = q;
    if (own->free) {
      s->low[j][i] = -INFINITY;
      s->high[j][i] = INFINITY;
    }
  }
  s->careful[i] = !plain;
  fresh(s, own, i, a->downhill ? (int)a->downhill : plain ? STEPS : CAREFUL);
  return 1;
}

/* Give a lane the next target; returns whether there is a try for it. */
static int take(const Asked *a, Lanes *s, Try *own, int i, int64_t target)
{
  Found *made = a->made + target;
  double sum = 0; /* NaN if the target has one */
  for (int j = 0; j < 12 * AIMS; ++j) s->target[j][i] = a->pose[12 * AIMS * target + j];
  own->target = target;
  own->bounded = narrow(a, s, target, i);
  own->free = 0;
  own->number = a->done;
  if (a->done == 0) made->cost = INFINITY;
  if (a->done == 0 && !a->downhill) {
    made->looks = made->found = 0;
    made->squares[0] = made->squares[1] = INFINITY;
    made->steep = NAN;
    for (int j = 0; j < N; ++j) made->q[j] = 0;
    for (int k = 0; k < PLACES; ++k) made->costs[k] = INFINITY;
  }
  own->looks = made->looks;
  for (int j = 0; j < 12 * AIMS; ++j) sum += 0 * a->pose[12 * AIMS * target + j];
  for (int j = 0; j < N && a->near != NULL; ++j) sum += 0 * a->near[target * N + j];
  return sum == 0 && !(a->skip != NULL && a->skip[target]) && begin(a, s, own, i);
}

/* After a try that did not arrive: keep its last posture if it is better than the worst kept one. */
static void keep(Found *made, const Lanes *s, int i)
{
  int worst = 0;
  for (int k = 1; k < PLACES; ++k) worst = made->costs[k] > made->costs[worst] ? k : worst;
  if (s->cost[i] < made->costs[worst]) {
    made->costs[worst] = s->cost[i];
    for (int j = 0; j < N; ++j) made->places[worst][j] = s->best[j][i];
  }
}

/* Make a lane's posture its target's answer so far. */
static void note(Found *made, const Lanes *s, int i)
{
  for (int j = 0; j < N; ++j) made->q[j] = s->best[j][i];
  for (int j = 0; j < 2; ++j) made->squares[j] = s->squares[j][i];
  made->cost = s->cost[i];
  made->steep = s->steep[i];
}

/* Write the row of a target that is found, as `Asked.reached` has it. */
static void tell(const Asked *a, int64_t target)
{
  const Found *made = a->made + target;
  const double *near = a->near == NULL ? NULL : a->near + target * N, half = sqrt(made->squares[1]) / 2;
  double *row = a->rows + target * (2 * N + 5), distance = 0;
  int gone = 0;
  for (int j = 0; near != NULL && j < N; ++j) gone |= fabs(made->q[j] - near[j]) > a->jump[j] * (1 + 1e-9);
  for (int j = 0; j < N; ++j) {
    const double about = near == NULL ? 0 : near[j], low = a->lower[j], high = a->upper[j];
    const double whole = a->turns[j] > 0 ? turned(made->q[j], about, a->turns[j], low, high) : made->q[j];
    const double q = whole < low ? low : whole > high ? high : whole;
    row[j] = gone ? NAN : q;
    row[N + 4 + j] = !gone && (q <= low + TOUCHING || q >= high - TOUCHING);
    distance = most(distance, fabs(q - about));
  }
  row[N] = gone ? JUMP : 0;
  row[N + 1] = gone ? NAN : sqrt(made->squares[0]);
  row[N + 2] = gone ? NAN : 2 * asin(least(half, 1));
  row[N + 3] = made->looks;
  row[2 * N + 4] = near == NULL || gone ? NAN : distance;
}

/* End the try of a lane; returns whether its target is done. */
static int over(const Asked *a, Lanes *s, Try *own, int i)
{
  Found *made = a->made + own->target;
  const double where = s->squares[0][i], turn = s->squares[1][i];
  if (where <= a->tolerance[0] * a->tolerance[0] && turn <= a->tolerance[1] * a->tolerance[1]) {
    if (own->free) {
      inward(a, s, own, i);
      return 0;
    }
    note(made, s, i);
    made->found = 1;
    made->looks = own->looks;
    if (a->rows != NULL) tell(a, own->target);
    return 1;
  }
  if (!s->arrived[i] && own->most <= CAREFUL && where <= COARSE * COARSE && turn <= COARSE * COARSE) {
    s->careful[i] = 1; /* close: some more steps */
    own->most += SLOW;
    return 0;
  }
  if (!a->downhill) {
    if (!own->free) keep(made, s, i);
  } else if (s->cost[i] < made->cost) {
    note(made, s, i);
  }
  own->number += 1;
  made->looks = own->looks;
  return !begin(a, s, own, i);
}

/* Give a lane a target, if one is left. */
static int fill(const Asked *a, Lanes *s, Try *own, int i, int64_t *next, int64_t last)
{
  for (; *next < last;) {
    if (take(a, s, own, i, (*next)++)) return 1;
  }
  own->target = -1;
  return 0;
}

void search(const Asked *a, int64_t first, int64_t last)
{
  Lanes s;
  Try own[W];
  int64_t next = first;
  int busy = 0;
  memset(&s, 0, sizeof s);
  for (int j = 0; j < 2; ++j) s.tolerance[j] = splat_F64(a->tolerance[j]);
  for (int j = 0; j < M; ++j) s.roots[j] = splat_F64(a->downhill ? a->roots[j] : 1);
  for (int i = 0; i < W; ++i) busy += fill(a, &s, &own[i], i, &next, last);
  for (; busy;) {
    look(&s);
    for (int i = 0; i < W; ++i) {
      Try *mine = &own[i];
      if (mine->target < 0) continue; /* no targets are left for this lane */
      mine->step += 1;
      mine->looks += 1;
      const int stuck = mine->most <= CAREFUL && s.steep[i] <= STUCK;
      if ((s.arrived[i] || stuck || mine->step >= mine->most) && over(a, &s, mine, i)) {
        busy -= !fill(a, &s, mine, i, &next, last);
      }
    }
  }
}

/* The waypoints of a path, each from the answer before it. The answers go into `near`, which asked->near points to and
   which has one row more. Returns the index of the first waypoint without an answer, or `count`. */
int64_t along(const Asked *a, double *near, int64_t count)
{
  for (int64_t k = 0; k < count; ++k) {
    const double *row = a->rows + k * (2 * N + 5);
    search(a, k, k + 1);
    if (!a->made[k].found) return k;
    for (int j = 0; j < N; ++j) near[(k + 1) * N + j] = row[N] == 0 ? row[j] : near[k * N + j];
  }
  return count;
}
