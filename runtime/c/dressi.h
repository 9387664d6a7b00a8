/* SPDX-License-Identifier: Apache-2.0
 * The C interface of Dressi: compile a program, bind arrays to its leaves, run its steps, read its outputs.
 *
 *   dressi_device* device = dressi_device_open("lavapipe", 0);
 *   dressi_bundle* bundle = dressi_compile("fit.dr", text, device, NULL);
 *   dressi_run* run = dressi_run_open(device, bundle, NULL);
 *   dressi_bind(run, "position", &position);
 *   dressi_step(run, "fit", 100);
 *   dressi_array alpha;
 *   dressi_output(run, "fit", "alpha", &alpha);
 *
 * Functions that can fail return NULL or 0; dressi_error() then says why, in one sentence or, of a program, as its
 * diagnostics. Nothing is thrown through this interface. Strings that are passed in are UTF-8 and are copied. What a
 * function returns lives until the object it was asked of is freed, or is asked again.
 *
 * Threads: calls on one run wait for each other; different runs of one device may be used by different threads. One
 * device or bundle may be given to functions that make others by several threads at a time, and so may
 * dressi_device_info(), dressi_bundle_bytes() and dressi_bundle_info() be called, whose answers stay. Answers that are
 * made anew, those of dressi_schedule() and of a run, are read by one thread before another one asks. Nothing is freed
 * while another thread uses it.
 *
 * Processes: after a fork, devices and runs that were opened before are an error in the child (DRESSI_DEVICE_ERROR), at
 * once. It may free them, which does nothing, use bundles, copies of arrays and views that it does not write to, and
 * open devices and runs of its own.
 */
#ifndef DRESSI_H
#define DRESSI_H

#include <stddef.h>
#include <stdint.h>

#if defined(__GNUC__)
#define DRESSI_API __attribute__((visibility("default")))
#else
#define DRESSI_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Raised when a caller built for an older number would go wrong. Functions are only ever added within a number. */
#define DRESSI_ABI_VERSION 1
DRESSI_API int dressi_abi_version(void);
DRESSI_API const char* dressi_version(void);

/* What went wrong in the last call of this thread that failed, and whose mistake it is. */
typedef enum dressi_error_kind {
  DRESSI_NO_ERROR = 0,
  DRESSI_USER_ERROR = 1,    /* the program, the data, or a call */
  DRESSI_DEVICE_ERROR = 2,  /* no such device, no memory, the device lost, a limit that it has */
  DRESSI_INTERNAL_ERROR = 3 /* a mistake of Dressi */
} dressi_error_kind;
DRESSI_API const char* dressi_error(void);
DRESSI_API dressi_error_kind dressi_error_kind_of_last(void);

/* A dense array: `components` scalars an element, elements x fastest, then y, then layer; a matrix column by column.
 * Row y = 0 is the top of a picture. Of arrays that come out, `data` belongs to `owner`. */
typedef enum dressi_kind { DRESSI_FLOAT32, DRESSI_FLOAT64, DRESSI_INT32, DRESSI_UINT32, DRESSI_BOOL } dressi_kind;
typedef struct dressi_array {
  int32_t kind;
  int32_t components;
  int64_t width, height, layers;
  void* data;
  void* owner; /* NULL of arrays that come in */
} dressi_array;
/* Frees an array that came out. */
DRESSI_API void dressi_array_free(dressi_array* array);

typedef struct dressi_device dressi_device;
typedef struct dressi_bundle dressi_bundle;
typedef struct dressi_run dressi_run;

/* The Vulkan devices of this machine as JSON: [{"name", "kind", "api_version", "driver"}]. */
DRESSI_API const char* dressi_devices(void);
/* `name`: part of a device's name or its number; empty or NULL: the first. "reference" is the float64 evaluator, which
 * needs no Vulkan. */
DRESSI_API dressi_device* dressi_device_open(const char* name, int validation);
DRESSI_API void dressi_device_free(dressi_device* device);
/* {"name", "kind", "api_version", "driver", "profile", "shares_memory"}; the last says whether CUDA may see its memory.
 */
DRESSI_API const char* dressi_device_info(dressi_device* device);

/* Compiles the text of a program; `name` stands for its file in messages, and its folder is where imports are looked
 * for; it has no control characters. `options` are pairs of words that end in NULL, as of drc's command line:
 * "profile", "lower", "raster", "pack", "scatter", "float", "ablate", "include", "define:K" for a const K, and
 * "known:X" for an input X. Without "profile" the device's own is used. "adjoint" with STEP:LEAF,...:OUTPUT,... adds a
 * step STEP.adjoint: its outputs, named as the leaves, are the gradients of the sum over the outputs, each times an
 * input STEP.adjoint.OUTPUT of its type and extent. It counts its own runs: dressi_set_runs() gives it the step_index
 * of the run whose gradient it is to be. */
DRESSI_API dressi_bundle* dressi_compile(const char* name, const char* text, dressi_device* device,
                                         const char* const* options);
/* Why the gradient of an output or `let` with respect to a leaf or `let` is what it is, of the program of this text, as
 * {"flows", "summary", "text", "paths": [[{"name", "place", "through"}]], "more_paths", "clamps", "cuts": [{"place",
 * "reason"}]}: what drc explain-grad prints is `text`. The answer lives until this thread asks again. */
DRESSI_API const char* dressi_explain_gradient(const char* name, const char* text, const char* const* options,
                                               const char* loss, const char* with_respect_to);
/* Reads a compiled bundle. */
DRESSI_API dressi_bundle* dressi_bundle_read(const void* bytes, size_t size);
DRESSI_API void dressi_bundle_free(dressi_bundle* bundle);
DRESSI_API const void* dressi_bundle_bytes(dressi_bundle* bundle, size_t* size);
/* {"leaves": [{"name", "kind", "type", "extent", "initial"}], "steps": [{"name", "outputs": [{"name", "type",
 * "extent"}], "leaves", "changes"}], "symbols", "profile"}; a type is GLSL's name, an extent three texts, of width,
 * height and layers. Leaves with "from_host" true take no memory of CUDA. */
DRESSI_API const char* dressi_bundle_info(dressi_bundle* bundle);

/* The commands of a step in the order in which they run: [{"kind", "label", "ops", "elements", "shaders", "reads",
 * "writes", "joins", "steady", "foresees", "leaves", "lines"}]; kinds are dispatch, draw, fill, copy and reduce,
 * `reads` and `writes` names of resources. A draw that joins belongs to the render pass before it; what is steady
 * changes in each run and is never left out. */
DRESSI_API const char* dressi_schedule(dressi_bundle* bundle, const char* step);

/* `options`: pairs as above, "cache", "rebuild", "store_all" and "share" with "on" or "off", "memory" with bytes,
 * at least 1. The bundle may be freed while the run lives, the device may not be used for anything else then but other
 * runs. */
DRESSI_API dressi_run* dressi_run_open(dressi_device* device, dressi_bundle* bundle, const char* const* options);
DRESSI_API void dressi_run_free(dressi_run* run);
/* Who is told, once of each, of outputs and leaves that are read and hold a NaN or Inf, and of passes that left one; a
 * line on stderr for NULL, as at first. It is called within the call that reads or runs, by its thread, so that calls
 * on the same run from there are an error. dressi_run_free() frees the run when that call ends, and the call's answer
 * with it. */
typedef void (*dressi_warn)(const char* warning, void* context);
DRESSI_API int dressi_on_warning(dressi_run* run, dressi_warn warn, void* context);
DRESSI_API int dressi_bind(dressi_run* run, const char* leaf, const dressi_array* data);
DRESSI_API int dressi_bind_symbol(dressi_run* run, const char* symbol, int64_t value);
DRESSI_API int dressi_step(dressi_run* run, const char* step, int times);
/* How often the step counts as having run, its step_index in the next run. */
DRESSI_API int dressi_set_runs(dressi_run* run, const char* step, int64_t runs);
DRESSI_API int dressi_output(dressi_run* run, const char* step, const char* name, dressi_array* out);
DRESSI_API int dressi_leaf(dressi_run* run, const char* name, dressi_array* out);
/* The same without a copy where the device is the host's processor: `data` is the memory that the device computes in.
 * They give 1 for such a view, 2 for a copy, 0 where they fail. dressi_array_free gives either back; memory of a view
 * lives until then, also when its run is freed. What is written to a leaf counts in the next run, and while a view of
 * it is held nothing that depends on it is skipped, nor anything while one of an output is, which the next run of any
 * step overwrites. What is written to an output changes no leaf: of one whose memory is a leaf's, as of an input
 * that is given out as it is, there is a copy alone. */
DRESSI_API int dressi_leaf_view(dressi_run* run, const char* name, dressi_array* out);
DRESSI_API int dressi_output_view(dressi_run* run, const char* step, const char* name, dressi_array* out);

/* ---- Memory shared with CUDA, on NVIDIA's devices, of a run that was opened with "share" "on" ----
 * In arrays here `data` is an address of CUDA; `stream` is a CUstream. Where there is no sharing these fail, and
 * dressi_error() says why. */
/* The number that CUDA has for the device and 1 more; 0 where there is none. */
DRESSI_API int dressi_cuda_device(dressi_device* device);
/* The stream that runs are in order with: each waits for what the stream was given before it, and the stream for it.
 * Neither holds up the host. NULL at first: the default stream. */
DRESSI_API int dressi_cuda_stream(dressi_run* run, void* stream);
/* Lets another stream wait for the runs so far. */
DRESSI_API int dressi_cuda_wait(dressi_run* run, void* stream);
/* A leaf, and an output of the step's last run, as dressi_leaf_view has them. `stride` (may be NULL) is how many
 * scalars lie from one element to the next. */
DRESSI_API int dressi_cuda_leaf(dressi_run* run, const char* name, dressi_array* out, int64_t* stride);
DRESSI_API int dressi_cuda_output(dressi_run* run, const char* step, const char* name, dressi_array* out,
                                  int64_t* stride);
/* Copies arrays to leaves, runs the step once (NULL: not at all) and copies outputs to arrays, all in order on the
 * stream: returns before any of it is done. Leaves whose `data` is NULL stay as they are. */
typedef struct dressi_named_array {
  const char* name;
  dressi_array array;
} dressi_named_array;
DRESSI_API int dressi_cuda_run(dressi_run* run, void* stream, const char* step, const dressi_named_array* leaves,
                               size_t leaf_count, const dressi_named_array* outputs, size_t output_count);

/* A DLManagedTensor of DLPack that shows the array and frees it in the end: of the device type and number, with so many
 * dimensions. The array is the tensor's then. */
DRESSI_API void* dressi_dlpack(dressi_array* array, int device_type, int device_id, int dimensions,
                               const int64_t* shape, const int64_t* strides);

/* Serves a page about the run on this machine's loopback address, at a port or, with 0, at any that is free, and gives
 * its address. Runs of dressi_watched_step() show there. */
DRESSI_API const char* dressi_watch(dressi_run* run, int port);
/* The page says that the run is over, and is no more. */
DRESSI_API int dressi_watch_end(dressi_run* run);
/* As dressi_step() for at most so many runs of the step, as the page has it: `made` says how many, which is 0 while it
 * is paused (after a tenth of a second, so that the caller may look at other things). Gives 2 once its stop was
 * pressed. */
DRESSI_API int dressi_watched_step(dressi_run* run, const char* step, int times, int* made);

/* {"runs", "commands", "ops", "bytes", "skipped_commands", "skipped_ops", "skipped_bytes"} of a step */
DRESSI_API const char* dressi_counters(dressi_run* run, const char* step);
/* Runs a step once and says how long each of its commands took: [{"label", "nanoseconds", "ops", "bytes", "lines"}] */
DRESSI_API const char* dressi_timed_step(dressi_run* run, const char* step);
/* Runs a step once and looks at every float that it stores: {} where all are finite, or the first that is not,
 * {"label", "value", "place", "x", "y", "layer", "lines"}. A run that was opened with "store_all" "on" stores all
 * values. */
DRESSI_API const char* dressi_checked_step(dressi_run* run, const char* step);

#ifdef __cplusplus
}
#endif

#endif
