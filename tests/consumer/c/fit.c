/* SPDX-License-Identifier: Apache-2.0
 * Compiles a program, and fits with it on the evaluator or the device that is named. usage: fit_in_c [DEVICE]
 */
#include <dressi.h>
#include <stdio.h>

static const char* const text =
    "edition 1; param x : float = 0.0; let error = (x - 3.0) * (x - 3.0);"
    "step fit { x <- x - 0.1 * grad(error, x); output error; }";

static double number_of(dressi_array* array) {
  const double number = array->kind == DRESSI_FLOAT64 ? *(double*)array->data : *(float*)array->data;
  dressi_array_free(array);
  return number;
}

int main(int count, char** words) {
  dressi_device* device = dressi_device_open(count > 1 ? words[1] : "reference", 0);
  dressi_bundle* bundle = device ? dressi_compile("fit.dr", text, device, NULL) : NULL;
  dressi_run* run = bundle ? dressi_run_open(device, bundle, NULL) : NULL;
  dressi_array leaf;
  double x;
  if (!run || !dressi_step(run, "fit", 100) || !dressi_leaf(run, "x", &leaf)) {
    fprintf(stderr, "%s\n", dressi_error());
    return 1;
  }
  x = number_of(&leaf);
  printf("x = %.3f\n", x);
  dressi_run_free(run);
  dressi_bundle_free(bundle);
  dressi_device_free(device);
  return x > 2.999 && x < 3.001 ? 0 : 1;
}
