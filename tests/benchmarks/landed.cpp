// The slipper of peer.cpp with steps that end on every touchdown and lift-off, so that RK4 keeps its fourth order.
//   g++ -O3 -march=native landed.cpp -o landed
//   ./landed SPEED CLEARANCE LENGTH STIFFNESS RESTITUTION AMPLITUDE ROLL_AMPLITUDE WAVELENGTH WAVELENGTH2 PERIODS STEPS V_Y
// V_Y is the start's lateral velocity [m/s]. Prints the state after each period.
#define main plain_main
#include "peer.cpp"
#undef main

const double GROWTH = 1.2;  // of the next step

struct Motion {
  double t, s[STATES], memory[CONTACTS];  // memory as in peer.cpp
};

// The motion after one step of RK4; leaves its gaps and rates in `p`.
Motion stepped(Peer &p, const Motion &from, double h) {
  double k1[STATES], k2[STATES], k3[STATES], k4[STATES], u[STATES];
  Motion to = from;
  p.derivative(from.t, from.s, from.memory, k1);
  for (int i = 0; i < STATES; i++) u[i] = from.s[i] + h / 2 * k1[i];
  p.derivative(from.t + h / 2, u, from.memory, k2);
  for (int i = 0; i < STATES; i++) u[i] = from.s[i] + h / 2 * k2[i];
  p.derivative(from.t + h / 2, u, from.memory, k3);
  for (int i = 0; i < STATES; i++) u[i] = from.s[i] + h * k3[i];
  p.derivative(from.t + h, u, from.memory, k4);
  for (int i = 0; i < STATES; i++) to.s[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
  to.t += h;
  p.derivative(to.t, to.s, to.memory, k1);
  return to;
}

// Negative where the last step passed an event of point q.
double ahead(const Peer &p, const Motion &motion, int q) { return motion.memory[q] < 0 ? -p.gap[q] : p.gap[q]; }

// The part of a step of length h after which the event of point q happens, by Newton's method within a bracket.
double until(Peer &p, const Motion &from, double h, int q) {
  double low = 0, high = h, place = h;
  for (int n = 0; n < 60; n++) {
    stepped(p, from, place);
    double value = ahead(p, from, q), slope = from.memory[q] < 0 ? -p.rate[q] : p.rate[q];
    (value < 0 ? high : low) = place;
    double next = place - value / slope;
    if (!(next > low && next < high)) next = (low + high) / 2;
    if (std::abs(next - place) < 1e-15 * h) break;
    place = next;
  }
  return place;
}

int main(int argc, char **argv) {
  if (argc != 13) return fprintf(stderr, "twelve arguments, see the top of landed.cpp\n"), 2;
  Peer p(argv);
  int periods = atoi(argv[10]), steps = atoi(argv[11]);
  // forces begin and end as a power of 1.5, so that steps are graded on both sides of an event
  double h = 2 * M_PI / p.w1 / steps, shortest = 1e-5 * h, longest = shortest, event = INFINITY;
  Motion motion = {0, {0, 0, 0, 0, 0, atof(argv[12]), .5, .2, .3, .4}, {}};
  for (int k = 0; k < periods * steps; k++) {
    double end = (k + 1) * h;
    while (motion.t < end) {
      double graded = std::max(shortest, (event - motion.t) * (1 - 1 / GROWTH));
      double part = std::min({end - motion.t, longest, graded}), place = part;
      bool last = part == end - motion.t;
      Motion next = stepped(p, motion, part);
      bool passed[CONTACTS];
      for (int q = 0; q < CONTACTS; q++) passed[q] = ahead(p, motion, q) < 0;
      int first = -1;
      for (int q = 0; q < CONTACTS; q++) {
        double own = passed[q] ? until(p, motion, part, q) : part;
        if (own < place) first = q, place = own;
      }
      if (first < 0) {
        longest = std::min(h, GROWTH * part);
        if (last) next.t = end;
      } else if (place > shortest) {
        event = motion.t + place;
        continue;
      } else {
        next = stepped(p, motion, place);
        next.memory[first] = next.memory[first] < 0 ? 0 : std::min(p.rate[first], -1e-9);
        longest = shortest;
        event = INFINITY;
      }
      motion = next;
    }
    if ((k + 1) % steps == 0) {
      printf("%d", (k + 1) / steps);
      for (double v : motion.s) printf(" %.16e", v);
      printf("\n");
    }
  }
}
