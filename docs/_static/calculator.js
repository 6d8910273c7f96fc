// Gains of a sampled loop on its drives, by the searches of cnclik.gains: the page "Which gain" has the theory.
// All poles ζ solve D(ζ) + s N(ζ) = 0, s the share of an error that a step removes.
const cnclik = (() => {
  // --- polynomials, lowest power first, and searches ------------------------------------------------------
  const plus = (p, q) => Array.from({ length: Math.max(p.length, q.length) }, (_, i) => (p[i] || 0) + (q[i] || 0));
  const scaled = (p, a) => p.map((c) => c * a);
  const times = (p, q) => p.reduce((sum, a, i) => plus(sum, [...Array(i).fill(0), ...scaled(q, a)]), []);
  const real = (p, x) => p.reduceRight((sum, c) => sum * x + c, 0);

  /** The value at e^{iω}, as [re, im]. */
  function onCircle(p, w) {
    const x = Math.cos(w), y = Math.sin(w);
    return p.reduceRight(([re, im], c) => [re * x - im * y + c, re * y + im * x], [0, 0]);
  }

  /** Whether all roots are within the unit circle (Schur and Cohn). */
  function decays(p) {
    const share = p[0] / p[p.length - 1], reversed = p.slice().reverse();
    return p.length === 1 || (Math.abs(share) < 1 && decays(p.slice(1).map((c, i) => c - share * reversed[i + 1])));
  }

  /** p without its real root r. */
  const without = (p, r) => p.slice(1).reduceRight((quotient, c) => [c + r * (quotient[0] || 0), ...quotient], []);

  const even = (to, points) => Array.from({ length: points }, (_, i) => (to * (i + 1)) / points);
  const geometric = (from, to, points) => even(1, points).map((share) => from * (to / from) ** share);

  /** The largest x below high for which holds(x) is false, where it is false at low. */
  function bisect(holds, low, high, halvings = 52) {
    for (let k = 0; k < halvings; k++) {
      const middle = (low + high) / 2;
      if (holds(middle)) high = middle; else low = middle;
    }
    return low;
  }

  /** The smallest x of a grid from which holds(x), bisected; inf if there is none. */
  function firstBeyond(holds, grid) {
    const i = grid.findIndex(holds);
    return i < 0 ? Infinity : bisect(holds, i ? grid[i - 1] : 0, grid[i]);
  }

  // --- a drive ------------------------------------------------------------------------------------------
  const positions = (drive) => drive.command === "position" && (drive.lag > 0 || drive.frequency > 0);

  /** The motion at time t after a unit step of the command. */
  function stepped(drive, t) {
    const { lag, frequency: w, damping } = drive, byPosition = positions(drive);
    if (!lag && !w) return t;
    if (lag) return byPosition ? -Math.expm1(-t / lag) : t + lag * Math.expm1(-t / lag);
    const a = damping * w, [cosine, sine] = decaying(drive, t), b = (2 * damping) / w;
    return byPosition ? 1 - cosine - a * sine : t - b + b * cosine + (a * b - 1) * sine;
  }

  /** e^{−at} cos bt and e^{−at} sin(bt)/b of a second-order drive. */
  function decaying({ frequency: w, damping }, t) {
    const a = damping * w, b = w * Math.sqrt(Math.abs(1 - damping ** 2));
    if (damping < 1) return [Math.exp(-a * t) * Math.cos(b * t), (Math.exp(-a * t) * Math.sin(b * t)) / b];
    const slow = Math.exp((b - a) * t), fast = Math.exp(-(a + b) * t);
    return [(slow + fast) / 2, b ? (slow - fast) / (2 * b) : t * slow];
  }

  /** G(ζ) = B/(ζ^{whole + 1} P), exact for commands that are constant for a sample. */
  function sampled(drive, Ts) {
    const whole = Math.floor(drive.delay), part = drive.delay - whole;
    let P = [1];
    if (drive.lag) P = [-Math.exp(-Ts / drive.lag), 1];
    if (drive.frequency) P = [Math.exp(-2 * drive.damping * drive.frequency * Ts), -2 * decaying(drive, Ts)[0], 1];
    if (!positions(drive)) P = times(P, [-1, 1]);
    const n = P.length, at = Array.from({ length: n + 1 }, (_, k) => (k ? stepped(drive, (k - part) * Ts) : 0));
    const pulse = [...at.slice(1).map((y, k) => y - at[k])].reverse(); // of a command of one sample, ζ⁻ⁿ … ζ⁻¹
    return { B: times(pulse, P).slice(n - 1), P, whole };
  }

  // --- the loop -----------------------------------------------------------------------------------------
  const kept = (drive, signal) => (drive.smoothed === signal ? drive.smoothing : 0);

  /** The drive as the loop sees it: its own commands have no drive. */
  const within = (drive) => (drive.feedback === "commanded" ? { delay: 0, smoothing: kept(drive, "error"), smoothed: "error" } : drive);

  /** ℓ = N/D with 1 + s ℓ(ζ) = 0 at all poles. */
  function loop(drive, Ts) {
    const { B, P, whole } = sampled(drive, Ts), A = [...Array(whole + 1).fill(0), ...P];
    const rho = kept(drive, "error") || kept(drive, "command"), filter = rho ? [-rho, 1] : [1];
    const N = times(B, rho ? [0, 1 - rho] : [1]), D = times(A, filter);
    if (drive.feedback === "rebased")
      return { N, D: kept(drive, "command") ? plus(D, scaled(N, -1)) : times(filter, plus(A, scaled(B, -1))) };
    return positions(drive) ? { N: [0, ...N], D: times(D, [-1, 1]) } : { N: scaled(N, 1 / Ts), D };
  }

  /** The least −1/ℓ over the frequencies where ℓ is real and negative: the phase crossovers. */
  function stableShare(drive, Ts) {
    const { N, D } = loop(within(drive), Ts);
    const gain = (w) => {
      const [a, b] = onCircle(N, w), [c, d] = onCircle(D, w);
      return { re: (a * c + b * d) / (c * c + d * d), positive: b * c > a * d };
    };
    const grid = [...geometric(1e-6, Math.PI, 1024), ...even(Math.PI, 1024)].sort((a, b) => a - b);
    const sides = grid.map((w) => gain(w).positive), at = [Math.PI];
    for (let i = 1; i < grid.length - 1; i++)
      if (sides[i] !== sides[i - 1]) at.push(bisect((w) => gain(w).positive === sides[i], grid[i - 1], grid[i]));
    const least = Math.min(...at.map((w) => -1 / gain(w).re).filter((share) => share > 0));
    return decays(plus(D, scaled(N, 1e-4 * Math.min(least, 1)))) ? least : 0;
  }

  /** The share up to which the real pole that starts at ζ = 1 is the slowest: it meets another one, or is passed. */
  function slowestShare({ N, D }, stable) {
    const share = (rate) => -real(D, Math.exp(-rate)) / real(N, Math.exp(-rate));
    const passed = (rate) => {
      const s = share(rate), pole = Math.exp(-rate), others = without(plus(D, scaled(N, s)), pole);
      return !(s <= stable && decays(others.map((c, i) => c * (pole * (1 - 1e-6)) ** i)));
    };
    return share(Math.min(firstBeyond(passed, geometric(1e-6, 30, 256)), 30));
  }

  /** Samples of the motion after the target has moved from 1 to 0, until it stays below 1e-6. */
  function motion(drive, Ts, s) {
    const { B, P, whole } = sampled(drive, Ts), rest = +positions(drive), n = P.length - 1;
    const q = Array(n).fill(1), sent = Array(n + whole + 1).fill(rest); // before that the drive rests at 1
    const ofError = kept(drive, "error"), ofCommand = kept(drive, "command");
    let total = 1, error = 0, command = rest;
    for (let k = 0, last = 0; k <= Math.min(2 * last + 4 * drive.delay + 50, 1e6); k++) {
      let now = 0;
      for (let i = 0; i <= n; i++) now += B[i] * sent[k + i] - (i < n ? P[i] * q[k + i] : 0);
      if (Math.abs(now) > 1e-6) last = k;
      const seen = drive.feedback === "commanded" ? total : now;
      error = ofError * error + (1 - ofError) * seen;
      total = (drive.feedback === "rebased" ? seen : total) - s * error;
      command = ofCommand * command + (1 - ofCommand) * (rest ? total : (-s * error) / Ts);
      q.push(now);
      sent.push(command);
    }
    return q.slice(n);
  }

  const overshoot = (path) => path.reduce((most, q) => Math.max(most, -q), 0);
  function smoothShare(drive, Ts, stable) {
    if (!stable) return 0;
    const swings = (s) => overshoot(motion(drive, Ts, s)) > 0.01, share = slowestShare(loop(within(drive), Ts), stable);
    return swings(share) ? bisect(swings, 0, share, 12) : share;
  }

  /** Shares: stable; without overshoot; the same with one more sample of dead time. */
  function limits(drive, Ts) {
    const stable = stableShare(drive, Ts), smooth = smoothShare(drive, Ts, stable);
    const late = drive.feedback === "commanded" ? { ...within(drive), delay: 1 } : { ...drive, delay: Math.min(drive.delay + 1, 101) };
    const recommended = Math.min(smooth, smoothShare(late, Ts, Math.min(stable, stableShare(late, Ts))));
    const heavier = (h) => ({ ...late, frequency: drive.frequency / h ** 0.5, damping: drive.damping / h ** 0.5 });
    const safe = drive.feedback !== "rebased" || [0.5, 1, 2].every((inertia) => stableShare(heavier(inertia), Ts));
    return [stable, smooth, safe ? recommended : 0];
  }

  // --- methods ------------------------------------------------------------------------------------------
  /** The slope k = −z (base + own k) of an implicit stage, by M passes from the step's first slope; null: solved. */
  function stage(z, base, own, M) {
    if (M === null) return (-z * base) / (1 + own * z);
    let slope = -z;
    for (let k = 0; k < M; k++) slope = -z * (base + own * slope);
    return slope;
  }

  /** 1 − R(z). */
  const REMOVED = {
    "EXP-MIDPOINT": (z) => -Math.expm1(-z),
    EE: (z) => z,
    HEUN: (z) => z - z ** 2 / 2,
    RK4: (z) => z - z ** 2 / 2 + z ** 3 / 6 - z ** 4 / 24,
    IE: (z, M) => -stage(z, 1, 1, M),
    CN: (z, M) => (z - stage(z, 1, 1, M)) / 2,
    TRAPEZOID: (z, M) => (z - stage(z, 1 - z / 2, 0.5, M)) / 2,
  };

  function gainRemoving(share, method, M) {
    if (method === "EXP-MIDPOINT") return share < 1 - 1e-12 ? -Math.log1p(-share) : Infinity;
    const beyond = (z) => { const taken = REMOVED[method](z, M); return !(taken <= share && taken >= -1e-15); };
    return firstBeyond(beyond, [...even(10, 1024), ...geometric(10, 1e6, 1024)]);
  }

  /** { stable, smooth, recommended } [1/s] of { delay [samples], lag, frequency, damping, command, feedback, … }. */
  function gains(drive, Ts, method = "EXP-MIDPOINT", M = null) {
    const [stable, smooth, recommended] = limits(drive, Ts).map((share) => gainRemoving(share, method, M) / Ts);
    const taken = (z) => REMOVED[method](z, M), most = Math.min(recommended * Ts, 1); // odd M removes less again beyond
    return { stable, smooth, recommended: most && even(most, 1024).reduce((a, b) => (taken(b) > taken(a) ? b : a)) / Ts };
  }

  /** Settling time [s] and overshoot of a gain. */
  function response(drive, Ts, alpha, method, M) {
    const late = kept(drive, "target"), path = motion(drive, Ts, REMOVED[method](alpha * Ts, M));
    if (late) [...path, ...Array(20000).fill(0)].reduce((mean, q, k) => (path[k] = late * mean + (1 - late) * q), 1);
    const away = path.map((q) => Math.abs(q) > 0.02).lastIndexOf(true);
    return { settling: away === path.length - 1 ? Infinity : (away + 1) * Ts, overshoot: overshoot(path) };
  }

  /** The recommended gain of the same loop by explicit Euler, as the setting of other tools. */
  function elsewhere(drive, Ts) {
    const z = (other) => Math.min(1, limits({ ...drive, ...other }, Ts)[2]) || null;
    const ideal = !drive.lag && !drive.frequency, velocity = !ideal && !positions(drive), measured = z({ feedback: "measured" });
    const prompt = ideal && !drive.delay && !drive.smoothing && drive.feedback !== "commanded";
    const look = ideal ? { lag: 0.03 } : { delay: Math.min(drive.delay + 0.03 / Ts, 100) };
    const rebased = prompt ? 1 : ideal || velocity ? null : z({ command: "position", feedback: "rebased" });
    const servoj = velocity ? null : z({ feedback: "measured", command: "position", ...look });
    return { pink: measured, placo: measured, moveit: measured && measured / Ts, isaac: rebased, servoj: servoj && servoj / Ts };
  }
  /** Why there is no answer: too late a loop, or a servo so slow beside Ts that rounding decides; "" where there is one. */
  function refusal({ delay, frequency: w, damping }, Ts) {
    if (delay > 100) return "no answer for more than 100 samples of dead time";
    return w && w * Ts < 2e-3 * Math.max(1, damping) ? "too slow a servo: ask ck.gains" : "";
  }
  return { gains, response, elsewhere, refusal };
})();

// --- the page -------------------------------------------------------------------------------------------
for (const form of document.querySelectorAll("#loop")) {
  const SAMPLING = [1, 2, 4, 8, 16, 32, 64], DEAD = [0, 5, 10, 20, 30, 50, 80]; // [ms]
  const value = (name) => form.elements[name].value, number = (name) => Math.max(0, Number(value(name)) || 0);
  const show = (x, digits = 4) => (x === Infinity ? "no limit" : x ? `${Number(x.toPrecision(digits))}` : "none");
  const nearest = (list, x) => list.reduce((a, b) => (Math.abs(b - x) < Math.abs(a - x) ? b : a));
  let timer;

  function update() {
    const Ts = Math.max(number("Ts"), 0.1) / 1e3, method = value("method"), M = value("M") === "" ? null : Math.round(number("M"));
    const lag = value("drive") === "lag" ? number("lag") / 1e3 : 0, frequency = value("drive") === "servo" ? number("frequency") : 0;
    const drive = {
      delay: number("dead") / 1e3 / Ts, lag, frequency, damping: number("damping") || 1,
      command: value("command") === "velocity" ? "velocity" : "position",
      feedback: value("command") === "rebased" && (lag || frequency) ? "rebased" : value("feedback"),
      smoothing: value("smoothed") === "none" ? 0 : Math.min(number("smoothing"), 0.999), smoothed: value("smoothed"),
    };
    const refused = cnclik.refusal(drive, Ts);
    const answers = refused ? {} : { ...cnclik.gains(drive, Ts, method, M), ...cnclik.elsewhere(drive, Ts) };
    answers.settling = answers.recommended && cnclik.response(drive, Ts, answers.recommended, method, M).settling;
    answers.margin = answers.recommended && answers.stable / answers.recommended;
    for (const cell of document.querySelectorAll("[data-answer]")) cell.textContent = refused || show(answers[cell.dataset.answer]);
    for (const label of form.querySelectorAll("[data-for]"))
      label.hidden = !label.dataset.for.split(" ").includes(value(label.dataset.of));
    history.replaceState(null, "", `#${new URLSearchParams(new FormData(form))}`);
    clearTimeout(timer);
    timer = setTimeout(chart, 0, drive, Ts, method, M);
  }

  /** The recommended gain over sampling time and dead time, row by row: the page answers meanwhile. */
  function chart(drive, Ts, method, M, i = 0) {
    const body = document.querySelector("#chart tbody"), row = body.rows[i] || body.insertRow();
    row.innerHTML = `<th scope="row">${DEAD[i]}</th>`;
    for (const T of SAMPLING) {
      const cell = row.insertCell(), { recommended } = cnclik.gains({ ...drive, delay: DEAD[i] / T }, T / 1e3, method, M);
      cell.textContent = cnclik.refusal({ ...drive, delay: 0 }, T / 1e3) ? "" : show(recommended, 2);
      cell.style.setProperty("--shade", `${Math.min(Math.max(36 * Math.log10(recommended), 0), 90)}%`);
      cell.ariaCurrent = T === nearest(SAMPLING, Ts * 1e3) && DEAD[i] === nearest(DEAD, drive.delay * Ts * 1e3);
    }
    if (i + 1 < DEAD.length) timer = setTimeout(chart, 0, drive, Ts, method, M, i + 1);
  }

  new URLSearchParams(location.hash.slice(1)).forEach((text, name) => { if (form.elements[name]) form.elements[name].value = text; });
  form.addEventListener("input", update);
  update();
}
