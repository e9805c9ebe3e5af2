/* libcamera_errors.hpp - errors of the module hdrig-libcamera.so: codes and sentences, no
 * exceptions.
 * thread: any; the last sentence is kept per thread. */
#ifndef DRIVERS_LIBCAMERA_ERRORS_HPP
#define DRIVERS_LIBCAMERA_ERRORS_HPP

#include "core/base/err.h"

#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <exception>
#include <new>

namespace
{

thread_local char last_text[512];

err_t fail(err_t code, const char *fmt, ...) __attribute__((format(printf, 2, 3)));
err_t fail(err_t code, const char *fmt, ...)
{
    va_list args;
    va_start(args, fmt);
    vsnprintf(last_text, sizeof last_text, fmt, args);
    va_end(args);
    return code;
}

/* No exception leaves the module. */
template <class F> err_t guarded(F f)
{
    try {
        return f();
    } catch (const std::bad_alloc &) {
        return fail(ERR_NOMEM, "libcamera: no memory");
    } catch (const std::exception &e) {
        return fail(ERR_IO, "libcamera: %s", e.what());
    } catch (...) {
        return fail(ERR_IO, "libcamera: an exception without a name");
    }
}

err_t code_of(int why)
{
    return why == -EBUSY ? ERR_BUSY : why == -ENODEV ? ERR_LOST : ERR_IO;
}

} // namespace

#endif
