/* The search for many targets, around `look`, which `native_source` writes for a chain and a task with `Lanes`, what it
   reads and writes; N and the other numbers in capitals are defined there, too. */
typedef struct { /* what a search comes to for a target; `search.Found` in Python */
  double q[N], squares[2], cost, steep; /* the best posture found, its errors' squares; see `step.Search` */
  double looks, found;
  double places[PLACES][N], costs[PLACES]; /* the best places of tries that did not arrive */
} Found;

typedef struct { /* of B targets; the same as `native._Call` */
  const double *pose, *near; /* (B, 12), (B, N) or NULL */
  const uint8_t *skip; /* (B) or NULL: nothing is tried for those */
  Found *made; /* (B) */
  double *rows; /* (B, 2 N + 5) or NULL: of targets that are found, what `result.from_rows` reads */
  const double *low, *high; /* (N) where joints are searched for; `jump` narrows that */
  const double *lower, *upper, *jump; /* (N) limits; INFINITY, where no jump is asked for */
  const double *periods, *turns; /* (N) what a joint turns by to the same posture, or 0; where several turns fit */
  const double *postures, *middle, *width; /* (SETS * SIZE, N), (N), (N) of the seeds */
  const float *features, *factors; /* (SETS, 13, SIZE), (12) */
  const double *roots; /* (M) of weights */
  double tolerance[2];
  int64_t done, tries, budget, seed; /* tries before; in all */
  int64_t downhill; /* steps from each of the places to the nearest pose, or 0: tries from seeds */
} Asked;

typedef struct { /* of one lane */
  int64_t target, number; /* number: of the try */
  int step, most;
  double looks;
} Try;

typedef float F __attribute__((vector_size(BYTES)));
typedef int32_t J __attribute__((vector_size(BYTES)));
#define WF (BYTES / 4)

/* The seed of a set whose tip is nearest to a target. */
static int64_t nearest(const Asked *a, const double *pose, int64_t set)
{
  const float *features = a->features + set * 13 * SIZE;
  F shortest = {0};
  J where = {0}, at = {0};
  float asked[12], smallest = INFINITY;
  int64_t found = 0;
  for (int i = 0; i < 12; ++i) asked[i] = (float)pose[i] * a->factors[i];
  for (int i = 0; i < WF; ++i) {
    shortest[i] = INFINITY;
    at[i] = i;
  }
  for (int k = 0; k < SIZE; k += WF) {
    F far, row;
    __builtin_memcpy(&far, features + 12 * SIZE + k, sizeof far);
    for (int i = 0; i < 12; ++i) {
      __builtin_memcpy(&row, features + i * SIZE + k, sizeof row);
      far = far + row * asked[i];
    }
    const J nearer = far < shortest;
    shortest = (F)((nearer & (J)far) | (~nearer & (J)shortest));
    where = (nearer & at) | (~nearer & where);
    at = at + WF;
  }
  for (int i = 0; i < WF; ++i) {
    if (shortest[i] < smallest) {
      smallest = shortest[i];
      found = where[i];
    }
  }
  return set * SIZE + found;
}

/* A joint's value by whole turns as near to `about` as the bounds let it be; as `seeds.turned`. */
static double turned(double q, double about, double period, double low, double high)
{
  const double few = ceil((low - q) / period), most = floor((high - q) / period), turns = rint((about - q) / period);
  if (!(period > 0 && few <= most)) return q;
  return q + period * (turns < few ? few : turns > most ? most : turns);
}

/* The next try of a lane's target; whether there is one. */
static int begin(const Asked *a, Lanes *s, Try *own, int i)
{
  const int64_t target = own->target;
  const Found *made = a->made + target;
  while (a->downhill && own->number < PLACES && !(made->costs[own->number] < INFINITY)) own->number += 1;
  if (own->number >= a->tries || (own->number >= PLAIN && own->looks >= (double)a->budget)) return 0;
  const int64_t k = own->number, number = a->seed + k;
  const int plain = k < PLAIN && !a->downhill, by = plain && a->near != NULL;
  const double stretch = k < SETS ? 1 : stretches[number % STRETCHES];
  const double *start, *place = NULL;
  if (a->downhill) {
    start = made->places[k];
  } else if (by) {
    start = a->postures + number % (SETS * SIZE) * N;
  } else if (k < SETS) {
    start = a->postures + nearest(a, a->pose + 12 * target, number % SETS) * N;
  } else {
    const uint32_t any = (uint32_t)number * SCATTER, some = (any >> 16) % PLACES;
    start = a->postures + (any >> 20) % (SETS * SIZE) * N;
    place = number % SELDOM == 0 && made->costs[some] < INFINITY ? made->places[some] : NULL;
  }
  for (int j = 0; j < N; ++j) {
    const double low = s->low[j][i], high = s->high[j][i], width = a->width[j] > 1e-9 ? a->width[j] : 1e-9;
    const double about = a->near == NULL ? 0 : a->near[target * N + j], from = (start[j] - a->middle[j]) / width;
    double q = start[j];
    if (by) {
      q = turned(about + AROUND * (double)k / PLAIN * 2 * from, about, a->periods[j], low, high);
    } else if (place != NULL) {
      q = place[j] + NEARBY * (q - a->middle[j]);
    } else if (!a->downhill) { /* as `seeds.starts` */
      if (a->near != NULL) q = turned(q, about, a->periods[j], low, high);
      if (q < low || q > high || (stretch > 1 && high - low < INFINITY)) q = low + (high - low) * (stretch * from + 0.5);
    }
    q = q < low ? low : q > high ? high : q;
    s->q[j][i] = s->best[j][i] = q;
  }
  s->squares[0][i] = s->squares[1][i] = s->cost[i] = s->steep[i] = INFINITY;
  s->trust[i] = 1;
  s->arrived[i] = 0;
  s->careful[i] = !plain;
  own->step = 0;
  own->most = a->downhill ? (int)a->downhill : plain ? STEPS : CAREFUL;
  return 1;
}

static double most(double a, double b) { return a > b ? a : b; }
static double least(double a, double b) { return a < b ? a : b; }

/* The next target for a lane; whether there is anything to try for it. */
static int take(const Asked *a, Lanes *s, Try *own, int i, int64_t target)
{
  Found *made = a->made + target;
  double sum = 0; /* NaN where the target is */
  for (int j = 0; j < N; ++j) { /* outside the limits: what is nearest to `near` */
    const double about = a->jump[j] < INFINITY ? a->near[target * N + j] : 0;
    const double low = least(most(a->low[j], about - a->jump[j]), a->high[j]);
    s->high[j][i] = most(least(a->high[j], about + a->jump[j]), a->low[j]);
    s->low[j][i] = low;
  }
  for (int j = 0; j < 3; ++j) s->position[j][i] = a->pose[12 * target + j];
  for (int j = 0; j < 9; ++j) s->rotation[j][i] = a->pose[12 * target + 3 + j];
  own->target = target;
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
  for (int j = 0; j < 12; ++j) sum += 0 * a->pose[12 * target + j];
  for (int j = 0; j < N && a->near != NULL; ++j) sum += 0 * a->near[target * N + j];
  return sum == 0 && !(a->skip != NULL && a->skip[target]) && begin(a, s, own, i);
}

/* A try that did not arrive: where it came to is kept, where it is better than the worst of those kept. */
static void keep(Found *made, const Lanes *s, int i)
{
  int worst = 0;
  for (int k = 1; k < PLACES; ++k) worst = made->costs[k] > made->costs[worst] ? k : worst;
  if (s->cost[i] < made->costs[worst]) {
    made->costs[worst] = s->cost[i];
    for (int j = 0; j < N; ++j) made->places[worst][j] = s->best[j][i];
  }
}

/* Where a lane is becomes its target's answer so far. */
static void note(Found *made, const Lanes *s, int i)
{
  for (int j = 0; j < N; ++j) made->q[j] = s->best[j][i];
  for (int j = 0; j < 2; ++j) made->squares[j] = s->squares[j][i];
  made->cost = s->cost[i];
  made->steep = s->steep[i];
}

/* The row of the record of a target that is found: as `Asked.reached` has it. */
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

/* What a lane does when its try is over; whether its target is done. */
static int over(const Asked *a, Lanes *s, Try *own, int i)
{
  Found *made = a->made + own->target;
  const double where = s->squares[0][i], turn = s->squares[1][i];
  if (where <= a->tolerance[0] * a->tolerance[0] && turn <= a->tolerance[1] * a->tolerance[1]) {
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
    keep(made, s, i);
  } else if (s->cost[i] < made->cost) {
    note(made, s, i);
  }
  own->number += 1;
  made->looks = own->looks;
  return !begin(a, s, own, i);
}

/* A target for a lane, if there is one left. */
static int fill(const Asked *a, Lanes *s, Try *own, int i, int64_t *next, int64_t last)
{
  while (*next < last) {
    if (take(a, s, own, i, (*next)++)) return 1;
  }
  own->target = -1;
  return 0;
}

void search(const Asked *a, int64_t first, int64_t last)
{
  Lanes s = {0};
  Try own[W];
  int64_t next = first;
  int busy = 0;
  for (int j = 0; j < 2; ++j) s.tolerance[j] = splat_F64(a->tolerance[j]);
  for (int j = 0; j < M; ++j) s.roots[j] = splat_F64(a->downhill ? a->roots[j] : 1);
  for (int i = 0; i < W; ++i) busy += fill(a, &s, &own[i], i, &next, last);
  while (busy) {
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

/* The waypoints of a path, each from the answer before it, of which `near` (what asked->near points to, and a row more)
   gets one after the other; the first that the tries have no answer for, or `count`. */
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
