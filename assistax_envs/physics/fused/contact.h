// Contacts: which candidates touch in each lane, and the point and frame of each contact.
//
// A geom is six numbers, position and half axis, in `Stage::geom`; a sphere is a capsule whose axis
// is zero, so that one formula serves spheres and capsules.

// The contacts of each lane, in slots: slot k holds a lane's k-th contact, whichever that is.
struct ContactList {
  int slots;  // in use: the most that any lane has
  int candidate[MAX_CONTACTS][W];  // -1: this lane has fewer contacts
  float first_end[MAX_CONTACTS][W], second_end[MAX_CONTACTS][W];  // see below
};
// Where on each segment a contact is, if that is known when it is listed; otherwise this.
#define NEAREST 2.0f

#define SMALLEST_DETERMINANT 1e-12f
#define PARALLEL 1e-15f  // MuJoCo's mjMINVAL: segments whose determinant is less count as parallel

FN float clip_lane(float x) { return x > 1.0f ? 1.0f : x < -1.0f ? -1.0f : x; }

FN float dot_lane(const float* a, const float* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// Whether two capsules of one lane touch at x on the first and y on the second segment.
FN bool touch_at(const float* a, const float* b, float x, float y, float reach) {
  float d[3];
  for (int j = 0; j < 3; ++j) d[j] = a[j] + x * a[3 + j] - b[j] - y * b[3 + j];
  return dot_lane(d, d) < reach * reach;
}

// Parallel capsules touch in two places: return how many, and where on both segments, as MuJoCo
// looks for them: at the ends of the first, then of the second segment, until there are two.
FN int parallel_contacts(const float* a, const float* b, float reach, float ends[2][2]) {
  float dif[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
  float aa = dot_lane(a + 3, a + 3), bb = dot_lane(b + 3, b + 3), ab = dot_lane(a + 3, b + 3);
  float u = -dot_lane(a + 3, dif), v = dot_lane(b + 3, dif);
  int found = 0;
  for (int k = 0; k < 4 && found < 2; ++k) {
    float end = k % 2 ? -1.0f : 1.0f;
    float x = k < 2 ? end : clip_lane((u + end * ab) / aa);
    float y = k < 2 ? clip_lane((v + end * ab) / bb) : end;
    if (!touch_at(a, b, x, y, reach)) continue;
    ends[found][0] = x;
    ends[found][1] = y;
    ++found;
  }
  return found;
}

// Return the number of contacts of a candidate that touches in lane l, and where they are.
FN int contact_ends(const Stage& now, int candidate, int l, float ends[2][2]) {
  const CandidateData& data = CANDIDATE[candidate];
  ends[0][0] = NEAREST;
  ends[0][1] = data.end == 0.0f ? NEAREST : data.end;
  if (!data.capsules) return 1;
  float a[6], b[6];
  for (int j = 0; j < 6; ++j) {
    a[j] = lane(now.geom[data.first][j], l);
    b[j] = lane(now.geom[data.second][j], l);
  }
  float c[3] = {a[4] * b[5] - a[5] * b[4], a[5] * b[3] - a[3] * b[5], a[3] * b[4] - a[4] * b[3]};
  if (dot_lane(c, c) >= PARALLEL) return 1;
  return parallel_contacts(a, b, GEOM[data.first].radius + GEOM[data.second].radius, ends);
}

// List what touches in every lane; one with more than MAX_CONTACTS keeps the first, and is flagged.
FN void list_contacts(const Stage& now, ContactList& list, Report& report) {
  integer touching[(NCANDIDATE + 31) / 32 + 1];
  UNROLL for (int w = 0; w < (NCANDIDATE + 31) / 32; ++w) touching[w] = splat(0);
  UNROLL for (int c = 0; c < NCANDIDATE; ++c)
    touching[c / 32] |= where(now.gap[c] < 0.0f, (int)(1u << (c % 32)));
  list.slots = 0;
  LANES(l) {
    int n = 0, lost = 0;
    for (int w = 0; w < (NCANDIDATE + 31) / 32; ++w)
      for (unsigned bits = lane(touching[w], l); bits; bits &= bits - 1) {
        int candidate = 32 * w + first_bit(bits);
        float ends[2][2];
        int found = contact_ends(now, candidate, l, ends);
        for (int j = 0; j < found; ++j) {
          if (n == MAX_CONTACTS) {
            ++lost;
            continue;
          }
          list.candidate[n][l] = candidate;
          list.first_end[n][l] = ends[j][0];
          list.second_end[n][l] = ends[j][1];
          ++n;
        }
      }
    if (lost) report.flags[l] += OVERFLOWED;
    report.effort[l] += EFFORT_OF_CONTACT * n;
    for (int k = n; k < MAX_CONTACTS; ++k) list.candidate[k][l] = -1;
    list.slots = n > list.slots ? n : list.slots;
  }
}

struct Contact {
  real point[3];
  real frame[3][3];  // normal, from the first to the second geom; two tangents
  real distance;     // of the surfaces; below 0
};

FN real dot3(const real* a, const real* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Complete a frame whose normal is given, and for a capsule on a plane the first tangent's
// direction, as MuJoCo's mju_makeFrame does.
FN void complete_frame(real frame[3][3], mask has_tangent, const real* tangent) {
  real *n = frame[0], *t = frame[1], *s = frame[2];
  mask level = absolute(n[1]) < 0.5f;  // otherwise the y axis would be too near to the normal
  real y = select(level, splat(1.0f), splat(0.0f));
  t[0] = select(has_tangent, tangent[0], splat(0.0f));
  t[1] = select(has_tangent, tangent[1], y);
  t[2] = select(has_tangent, tangent[2], 1.0f - y);
  real along = dot3(n, t);
  UNROLL for (int j = 0; j < 3; ++j) t[j] = t[j] - n[j] * along;
  real inverse = 1.0f / square_root(dot3(t, t));
  UNROLL for (int j = 0; j < 3; ++j) t[j] = t[j] * inverse;
  s[0] = n[1] * t[2] - n[2] * t[1];
  s[1] = n[2] * t[0] - n[0] * t[2];
  s[2] = n[0] * t[1] - n[1] * t[0];
}

// The two geoms of the contacts in one slot, for all lanes.
struct Touch {
  real first[6], second[6];  // position and half axis
  real first_radius, second_radius;
  real x, y;  // where on each segment, or NEAREST
  mask on_plane, capsule;  // what the first and the second are
};

// Lanes that have no contact in slot k take candidate 0's numbers.
FN void gather_touch(const Stage& now, const ContactList& list, int k, Touch& touch) {
  Gathered first[6], second[6], first_radius, second_radius, x, y, plane, half_length;
  LANES(l) {
    int c = list.candidate[k][l];
    bool none = c < 0;
    const CandidateData& data = CANDIDATE[none ? 0 : c];
    for (int j = 0; j < 6; ++j) {
      first[j].at[l] = lane(now.geom[data.first][j], l);
      second[j].at[l] = lane(now.geom[data.second][j], l);
    }
    first_radius.at[l] = GEOM[data.first].radius;
    second_radius.at[l] = GEOM[data.second].radius;
    x.at[l] = none ? NEAREST : list.first_end[k][l];
    y.at[l] = none ? NEAREST : list.second_end[k][l];
    plane.at[l] = data.end == 0.0f ? 0.0f : 1.0f;
    half_length.at[l] = GEOM[data.second].half_length;
  }
  UNROLL for (int j = 0; j < 6; ++j) {
    touch.first[j] = all(first[j]);
    touch.second[j] = all(second[j]);
  }
  touch.first_radius = all(first_radius);
  touch.second_radius = all(second_radius);
  touch.x = all(x);
  touch.y = all(y);
  touch.on_plane = all(plane) > 0.5f;
  touch.capsule = all(half_length) > 0.0f;
}

// Find where on the segments the contact is, each in [-1, 1], as `collision.py` does.
FN void find_nearest(Touch& touch) {
  const real *a = touch.first, *b = touch.second;
  real dif[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
  real aa = maximum(dot3(a + 3, a + 3), 1e-12f), bb = maximum(dot3(b + 3, b + 3), 1e-12f);
  real ab = -dot3(a + 3, b + 3), u = -dot3(a + 3, dif), v = dot3(b + 3, dif);
  real determinant = maximum(aa * bb - ab * ab, SMALLEST_DETERMINANT);
  real x = clip((bb * u - ab * v) / determinant);
  real y = clip((v - ab * x) / bb);
  x = clip((u - ab * y) / aa);
  touch.x = select(touch.x < NEAREST, touch.x, x);
  touch.y = select(touch.y < NEAREST, touch.y, y);
}

// Two spheres about the points `from` and `to` of the segments: the contact is half way between.
FN void place_spheres(const Touch& touch, const real* from, const real* to, Contact& contact) {
  real* normal = contact.frame[0];
  UNROLL for (int j = 0; j < 3; ++j) normal[j] = to[j] - from[j];
  real length = square_root(dot3(normal, normal)), inverse = 1.0f / maximum(length, 1e-9f);
  contact.distance = length - touch.first_radius - touch.second_radius;
  real deep = touch.first_radius + 0.5f * contact.distance;
  UNROLL for (int j = 0; j < 3; ++j) {
    normal[j] = normal[j] * inverse;
    contact.point[j] = from[j] + normal[j] * deep;
  }
}

// A sphere about the point `to` on a plane, in the lanes that have one.
FN void place_on_plane(const Touch& touch, const real* to, Contact& contact) {
  real *normal = contact.frame[0], above[3];
  UNROLL for (int j = 0; j < 3; ++j) {
    normal[j] = select(touch.on_plane, touch.first[3 + j], normal[j]);
    above[j] = to[j] - touch.first[j];
  }
  real height = dot3(normal, above) - touch.second_radius;
  contact.distance = select(touch.on_plane, height, contact.distance);
  real deep = touch.second_radius + 0.5f * contact.distance;
  UNROLL for (int j = 0; j < 3; ++j)
    contact.point[j] = select(touch.on_plane, to[j] - normal[j] * deep, contact.point[j]);
}

// The contact in slot k of every lane.
FN void place_contact(const Stage& now, const ContactList& list, int k, Contact& contact) {
  Touch touch;
  gather_touch(now, list, k, touch);
  find_nearest(touch);
  real from[3], to[3];
  UNROLL for (int j = 0; j < 3; ++j) {
    from[j] = touch.first[j] + touch.x * touch.first[3 + j];
    to[j] = touch.second[j] + touch.y * touch.second[3 + j];
  }
  place_spheres(touch, from, to, contact);
#ifdef HAS_PLANE
  place_on_plane(touch, to, contact);
#endif
  complete_frame(contact.frame, both(touch.on_plane, touch.capsule), touch.second + 3);
}
