# make            build/hdrig and its libraries     make test    the quick tests: 2 minutes
# make demo       first scene, in out/latest        make check   before a commit: 10 minutes
# make check-long the rest: sanitizers, emulation, soaks
# make picture    the picture of README.md
# make install    DESTDIR= PREFIX= BOARD=           make deb     Debian package, BOARD=
# make uninstall  DESTDIR= PREFIX=                  removes what install wrote
# make check-kernel  drivers under real kernels: TEST=gpio, BENCH=uml|qemu
# make check-rig     a rig of boards in network namespaces: MEMBERS=16 TAKES=25 SEED=1, as root
# make check-mpi     ranks of Open MPI in network namespaces: RANKS="1 2 4" VIEWS=8, as root
# make check-distro  on another Debian, as root: SUITE=trixie|bookworm
# make check-train   the training of the small network: PYTHON= with PyTorch
# make fuzz       SECONDS= for each target (clang)
# make bench lint format deps clean
# Variants live side by side in build/<arch>[-clang][-san][-werror]:
# CROSS=aarch64-linux-gnu- (deb, too)  SAN=address,undefined
# PIC=1 (for libsim.so, which sim/train loads)

# Packages of Debian 12 and 13: to build and run, and to check.
DEPS := gcc g++ libc6-dev make pkg-config libspng-dev libturbojpeg0-dev libexif-dev \
	libtiff-dev libheif-dev libwebp-dev libopenexr-dev libcjson-dev libinih-dev libzip-dev libraw-dev \
	libgpiod-dev libcamera-dev libmicrohttpd-dev libmosquitto-dev libcurl4-openssl-dev \
	libqrencode-dev libsystemd-dev zlib1g-dev libzstd-dev libapriltag-dev libopenmpi-dev \
	dpkg-dev
DEPS_CHECK := $(DEPS) libcmocka-dev openmpi-bin libmpich-dev mpich mosquitto openssl iproute2 \
	clang libclang-rt-dev lld cppcheck chromium firefox-esr systemd lintian ffmpeg qemu-user \
	xvfb gcc-aarch64-linux-gnu libc6-dev-arm64-cross $(if $(shell command -v npm 2>/dev/null),,npm)
DEPS_CROSS := $(DEPS) gcc-aarch64-linux-gnu g++-aarch64-linux-gnu
DEPS_KERNEL := $(DEPS) bc bison dmsetup e2fsprogs flex kmod libcamera-ipa udev xz-utils
DEPS_QEMU := cpio linux-headers-amd64 qemu-system-x86
# The rules of accessibility, a package of npm.
AXE := axe-core@4.14.1
AXE_SHA256 := e6b0ce02b84d892e2e33e403485e7f3d6c29e2be6df65daf44d89ba564139745

VERSION := 0.5.0
PREFIX ?= /usr/local
SECONDS ?= 60
DEMO := 13

ifeq ($(origin CC),default)
CC := $(CROSS)gcc
endif
CXX := $(if $(findstring clang,$(CC)),clang++,$(CROSS)g++)
AR := $(CROSS)ar
ARCH := $(if $(CROSS),$(firstword $(subst -, ,$(CROSS))),$(shell uname -m))
comma := ,
V := $(ARCH)$(if $(findstring clang,$(CC)),-clang)
V := $(V)$(if $(SAN),-$(subst $(comma),-,$(SAN)))$(if $(WERROR),-werror)$(if $(PIC),-pic)
B := build/$(V)

# A cross build has the libraries of Debian for that architecture.
DEB_ARCH := $(if $(filter aarch64,$(ARCH)),arm64,amd64)
SYSROOT := $(if $(CROSS),$(CURDIR)/build/sysroot-$(DEB_ARCH))
SYSROOT_LIB := $(SYSROOT)/usr/lib/$(CROSS:%-=%)
SYSROOT_NEEDS := libc6-dev $(filter-out libc6-dev,$(filter lib% zlib%,$(DEPS)))
PKG_CONFIG := $(if $(CROSS),PKG_CONFIG_SYSROOT_DIR=$(SYSROOT) \
	PKG_CONFIG_LIBDIR=$(SYSROOT_LIB)/pkgconfig) pkg-config

# --- flags ----------------------------------------------------------------------------------------
# Only kernels may fuse products to FMA: everything else gives the same bytes on every machine.
OPT := -O2 -ffp-contract=off
# Readers of files. Enumerators are our integer constants.
CONVERSION := -Wconversion -Wno-enum-float-conversion
WARN := -Wall -Wextra -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Wvla -Wundef \
	$(if $(WERROR),-Werror)
# With -O1 sanitized code compiles in half the time, and runs as fast.
SANFLAGS := $(if $(SAN),-fsanitize=$(SAN) -fno-sanitize-recover=all -fno-omit-frame-pointer \
	-O1 -g1 -Wno-format-truncation -DSANITIZED)
FLAGS = -std=c11 -D_GNU_SOURCE -I. -g -pthread $(if $(PIC),-fPIC) -MMD -MP $(OPT) $(WARN) \
	$(ROOTED) $(MORE) $(SANFLAGS) $(CFLAGS)
# The module alone is C++; libcamera's headers want C++20 from 0.7.1 on.
CXXFLAGS_MODULE = -std=c++20 -I. -g -O2 -fPIC -shared -fvisibility=hidden -Wall -Wextra \
	-Wshadow -Wundef $(if $(WERROR),-Werror) $(ROOTED) $(SANFLAGS)
LDLIBS = -lspng -lturbojpeg -lexif -lraw_r -ltiff -lheif -lwebp -lcjson -linih -lzip -lz -lzstd \
	-lapriltag -lmicrohttpd -lmosquitto -lcurl -lqrencode -lsystemd -lgpiod -lm \
	$(filter -lOpenEXRCore%,$(shell $(PKG_CONFIG) --libs OpenEXR))

# A file named op_ISA.c is compiled for that instruction set, and no other file is.
ISA_sse41 := -msse4.1
ISA_avx2 := -mavx2 -mfma -mf16c
ISA_avx512 := $(ISA_avx2) -mavx512f -mavx512bw -mavx512vl -mavx512dq -mprefer-vector-width=512
ISA_avx512vnni := $(ISA_avx512) -mavx512vnni
ISA_amx := -mamx-tile -mamx-int8
ISA_neondot := -march=armv8.2-a+dotprod -mtune=cortex-a76
ISA_i8mm := -march=armv8.2-a+i8mm
isa = $(ISA_$(lastword $(subst _, ,$(notdir $*))))

# --- sources --------------------------------------------------------------------------------------
OTHER_ISA := $(if $(filter x86_64,$(ARCH)),,%_sse41.c %_avx2.c %_avx512.c %_avx512vnni.c %_amx.c)
OTHER_ISA += $(if $(filter aarch64,$(ARCH)),,%_neon.c %_neondot.c %_i8mm.c)
CORE := $(filter-out $(OTHER_ISA),$(wildcard core/*/*.c))
DRIVERS := $(filter-out drivers/net/mpi_shim.c,$(wildcard drivers/*/*.c))
SIM := $(wildcard sim/*/*.c)
MAINS := firmware/cmd/hdrig.c firmware/daemon/hdrigd.c
FIRMWARE := $(filter-out $(MAINS),$(wildcard firmware/*/*.c))
TESTS := $(wildcard tests/unit/*/*/*_test.c tests/kernels/*_test.c tests/golden/*_test.c)
FAULT := $(wildcard tests/fault/*_test.c)
E2E := $(wildcard tests/e2e/*.c)
FUZZ := $(wildcard tests/fuzz/fuzz_*.c)
LINUX := $(filter-out tests/linux/uvc.c,$(wildcard tests/linux/*.c))

# Threads are tested with TSan: *_tsan_test and these.
TSAN_TESTS := tasks pool prep response seed appearance shared_attention consensus depth gausshead \
	modelfile sample camera_libcamera writer mqtt
# What others reach: files, devices, connections. `make check` sanitizes these alone.
EDGE_TESTS := $(filter $(patsubst %,tests/unit/%/%,drivers firmware/store firmware/daemon \
	firmware/rig),$(TESTS))
# Core alone is tested on emulated Arm: what needs neither files nor minutes.
ARM_TESTS := $(addprefix unit/core/,base/arena base/bytes base/cpu base/err base/gaussians \
	base/half base/pool base/sha256 net/appearance net/shared_attention net/depth net/gausshead \
	net/layer net/pack photo/metrics refine/loss splat/raster) \
	golden/render kernels/fft kernels/gemm kernels/kernels kernels/nn kernels/nn_range

TSAN_SOURCES := $(filter %_tsan_test.c $(addprefix %/,$(addsuffix _test.c,$(TSAN_TESTS))),\
	$(TESTS))
TSAN_PROGRAMS = $(call programs,$(TSAN_SOURCES))
EDGE_PROGRAMS = $(call programs,$(EDGE_TESTS))
INNER_PROGRAMS = $(call programs,$(filter-out $(EDGE_TESTS),$(TESTS)))
ARM_PROGRAMS = $(ARM_TESTS:%=$(B)/tests/arm/%_test)

objects = $(1:%.c=$(B)/%.o)
programs = $(1:%.c=$(B)/%)
LIBS := $(B)/libfirmware.a $(B)/libsim.a $(B)/libdrivers.a $(B)/libcore.a
TOOLS := $(addprefix $(B)/,$(basename $(notdir $(MAINS))))
MODULE := $(B)/hdrig-libcamera.so
# Those of MPI: of MPICH where it is.
MPI_SHIM := drivers/net/mpi_shim.c
MPI_MODULES := $(B)/hdrig-openmpi.so \
	$(if $(CROSS),,$(if $(shell pkg-config --exists mpich && echo yes),$(B)/hdrig-mpich.so))
MODULE_NEEDS := drivers/device/libcamera_shim.cpp $(wildcard drivers/device/libcamera_*.h*) \
	drivers/device/camera.h drivers/device/focus.h Makefile

# --- build ----------------------------------------------------------------------------------------
.PHONY: all demo libsim check check-long test lint format deps deps-check install uninstall deb \
	clean fuzz bench picture objects tests tsan-tests arm-tests fault-tests fuzz-targets check-kernel \
	check-train check-distro check-rig check-mpi edge-tests inner-tests deps-kernel deps-qemu \
	deps-cross
.DELETE_ON_ERROR:
.SECONDARY:

all: deps $(LIBS) $(TOOLS) $(MODULE) $(MPI_MODULES) \
	$(if $(filter $(shell uname -m),$(V)),$(TOOLS:$(B)/%=build/%)) build/small.hdrig

# build/hdrig is the plain native one.
build/hdrig build/hdrigd: build/%: build/$(V)/%
	ln -sf $(V)/$* $@

# The model that comes with the program, from the weights that training can go on from.
MODEL := sim/train/small.safetensors
build/small.hdrig: $(MODEL) core/net/pack.c core/net/table.c
ifeq ($(CROSS),)
build/small.hdrig: | $(B)/hdrig
	$(B)/hdrig convert $< --config $(MODEL:.safetensors=.json) --precision int8 --out $@ \
	    2>build/small.log || { cat build/small.log; exit 1; }
else
	$(MAKE) -s CROSS= $@
endif

$(B)/%.o: %.c Makefile | build/deps
	@mkdir -p $(@D)
	$(CC) $(FLAGS) $(isa) -c $< -o $@

# Core needs no library, so its tests build without these packages.
ifneq ($(CROSS),)
IN_SYSROOT := $(call objects,$(DRIVERS) $(FIRMWARE) $(MAINS) $(SIM)) $(TOOLS) $(MODULE) \
	$(MPI_MODULES)
$(IN_SYSROOT): | $(SYSROOT)/packages
$(IN_SYSROOT): private ROOTED = --sysroot=$(SYSROOT)
endif
$(SYSROOT)/packages: Makefile board/debian/sysroot.sh | build/deps-cross
	@board/debian/sysroot.sh $(DEB_ARCH) $(@D) $(SYSROOT_NEEDS)

$(B)/core/kernels/%.o: OPT := -O3 -ffp-contract=fast
# Products fill all registers of Arm: gcc's scheduling before their allocation would spill them.
$(B)/core/kernels/gemm_%.o: OPT += $(if $(filter aarch64,$(ARCH)),$(if $(findstring \
	clang,$(CC)),,-fno-schedule-insns -frename-registers))
# Plain loops that gcc 12 vectorises only with these flags: they take half the time.
$(B)/core/net/%.o: OPT := -O3 -ffp-contract=off
$(B)/core/stereo/%.o: OPT := -O3 -ffp-contract=off
$(B)/sim/%.o: OPT := -O3 -ffp-contract=off
$(B)/drivers/%.o: MORE = $(CONVERSION) $(shell $(PKG_CONFIG) --cflags OpenEXR)
$(B)/firmware/base/config.o: MORE = $(CONVERSION)
$(MAINS:%.c=$(B)/%.o): MORE = -DHDRIG_VERSION='"$(VERSION)"'
$(addprefix $(B)/firmware/,daemon/http.o result/viewer.o result/report_page.o): \
		$(wildcard firmware/web/*)

$(B)/libcore.a: $(call objects,$(CORE))
$(B)/libdrivers.a: $(call objects,$(DRIVERS))
$(B)/libfirmware.a: $(call objects,$(FIRMWARE))
$(B)/libsim.a: $(call objects,$(SIM))
$(LIBS):
	@mkdir -p $(@D)
	@rm -f $@
	$(AR) qcs $@ $^

# Worlds, sensor and renderer for Python: make libsim. Without what needs drivers.
SIM_ALONE := $(filter-out $(shell grep -l '"drivers/' $(SIM)) \
	sim/device/camera_% sim/device/feed.c,$(SIM))
libsim:
	@$(MAKE) -s PIC=1 build/$(V)-pic/libsim.so
$(B)/libsim.so: $(call objects,$(SIM_ALONE) $(CORE))
	$(CC) $(FLAGS) -shared -Wl,-z,defs $^ -lm -o $@

$(B)/hdrig: $(B)/firmware/cmd/hdrig.o $(LIBS)
$(B)/hdrigd: $(B)/firmware/daemon/hdrigd.o $(LIBS)
$(TOOLS):
	$(CC) $(FLAGS) $^ $(LDLIBS) -o $@

# The module for libcamera, which drivers/device/camera_libcamera.c loads if it is there.
$(B)/hdrig-libcamera.so: $(MODULE_NEEDS) | build/deps
	@mkdir -p $(@D)
	$(CXX) $(CXXFLAGS_MODULE) -Wconversion -o $@ $< \
		$(patsubst -I%,-isystem %,$(shell $(PKG_CONFIG) --cflags --libs libcamera))

# What drivers/net/ranks.c loads.
$(B)/hdrig-openmpi.so: MPI := ompi-c
$(B)/hdrig-mpich.so: MPI := mpich
$(B)/hdrig-openmpi.so $(B)/hdrig-mpich.so: $(MPI_SHIM) $(MPI_SHIM:.c=.h) core/base/team.h Makefile \
		| build/deps
	@mkdir -p $(@D)
	$(CC) -std=c11 -D_GNU_SOURCE -I. -g -O2 -fPIC -shared -fvisibility=hidden -pthread $(WARN) \
	    $(ROOTED) $(SANFLAGS) -o $@ $< \
	    $(patsubst -I%,-isystem %,$(shell $(PKG_CONFIG) --cflags --libs $(MPI)))

LIB = $(DESTDIR)$(PREFIX)/lib
SHARE = $(DESTDIR)$(PREFIX)/share/hdrig
ETC = $(DESTDIR)/etc/hdrig

# Settings that were changed are kept; share/hdrig has those of the last installation to compare.
put_settings = f=$(ETC)/$(notdir $1); last=$(SHARE)/$(notdir $1); \
	mine() { [ -e $$1 ] && ! cmp -s $$1 $1 && ! cmp -s $$1 $$last; }; \
	if ! mine $$f; then install -m 644 $1 $$f; \
	elif mine $$f.new; then echo "$$f and $$f.new were changed and stay; ours is $$last"; \
	else install -m 644 $1 $$f.new; echo "$$f was changed and stays; ours is $$f.new"; fi && \
	install -m 644 $1 $$last

install: all
	$(if $(BOARD),@test -f board/$(BOARD)/board.conf || \
	    { echo "no board/$(BOARD)/board.conf: $(filter-out common debian, \
	    $(notdir $(wildcard board/*)))"; exit 1; })
	install -d $(DESTDIR)$(PREFIX)/bin $(DESTDIR)$(PREFIX)/share/hdrig $(DESTDIR)/etc/hdrig
	install -m 755 $(TOOLS) $(DESTDIR)$(PREFIX)/bin
	install -D -m 644 $(MODULE) $(LIB)/hdrig/$(notdir $(MODULE))
	install -m 644 $(MPI_MODULES) $(LIB)/hdrig
	install -m 644 build/small.hdrig $(DESTDIR)$(PREFIX)/share/hdrig
	@$(call put_settings,board/common/defaults.conf)
	$(if $(BOARD),@$(call put_settings,board/$(BOARD)/board.conf))
	install -D -m 644 board/common/60-hdrig.rules $(LIB)/udev/rules.d/60-hdrig.rules
	install -D -m 644 board/common/hdrig.sysusers $(LIB)/sysusers.d/hdrig.conf
	install -d $(LIB)/systemd/system
	sed 's|@BIN@|$(PREFIX)/bin|' board/common/hdrigd.service >$(LIB)/systemd/system/hdrigd.service
	$(if $(DESTDIR),,if [ -d /run/systemd/system ]; then \
	    systemd-sysusers $(LIB)/sysusers.d/hdrig.conf; udevadm control --reload; \
	    udevadm trigger --subsystem-match=gpio; systemctl daemon-reload; fi)

# Removes what install wrote, but neither settings that were changed nor files of the user.
uninstall:
	$(if $(DESTDIR),,if [ -d /run/systemd/system ]; then systemctl disable --now hdrigd || true; fi)
	@for f in defaults.conf board.conf; do \
	    if cmp -s $(ETC)/$$f $(SHARE)/$$f; then rm $(ETC)/$$f; \
	    elif [ -e $(ETC)/$$f ]; then echo "$(ETC)/$$f was changed and stays"; fi; \
	    if cmp -s $(ETC)/$$f.new $(SHARE)/$$f; then rm $(ETC)/$$f.new; \
	    elif [ -e $(ETC)/$$f.new ]; then echo "$(ETC)/$$f.new was changed and stays"; fi; done
	rm -f $(addprefix $(DESTDIR)$(PREFIX)/bin/,hdrig hdrigd) $(LIB)/hdrig/hdrig-*.so \
	    $(addprefix $(SHARE)/,small.hdrig defaults.conf board.conf) \
	    $(LIB)/udev/rules.d/60-hdrig.rules $(LIB)/sysusers.d/hdrig.conf \
	    $(LIB)/systemd/system/hdrigd.service
	-@rmdir --ignore-fail-on-non-empty $(wildcard $(LIB)/hdrig $(SHARE) $(ETC))
	@echo "captures, scenes and calibrations stay in /var/lib/hdrig, group hdrig stays"

# BOARD=rpi5: a package with the settings of that board; CROSS=aarch64-linux-gnu-: for arm64.
SHLIBDEPS = DEB_HOST_ARCH=$(DEB_ARCH) dpkg-shlibdeps $(if $(CROSS), \
	--admindir=$(SYSROOT)/var/lib/dpkg -l$(SYSROOT_LIB))
deb: all
	rm -rf build/deb
	mkdir -p build/deb/root/DEBIAN build/deb/debian
	@$(MAKE) -s install DESTDIR=$(CURDIR)/build/deb/root PREFIX=/usr
	$(CROSS)strip --strip-unneeded build/deb/root/usr/bin/* build/deb/root/usr/lib/hdrig/*.so
	install -D -m 644 README.md build/deb/root/usr/share/doc/hdrig/README.md
	install -D -m 644 LICENSE build/deb/root/usr/share/doc/hdrig/copyright
	install -m 755 board/debian/postinst board/debian/prerm build/deb/root/DEBIAN
	cd build/deb/root && find etc -type f | sed 's|^|/|' >DEBIAN/conffiles
	echo "Source: hdrig" >build/deb/debian/control
	sed "s/@VERSION@/$(VERSION)/; s/@DATE@/$$(date -R)/" board/debian/changelog | gzip -9n \
	    >build/deb/root/usr/share/doc/hdrig/changelog.gz
	cd build/deb && $(SHLIBDEPS) -O root/usr/bin/hdrig root/usr/bin/hdrigd \
	    root/usr/lib/hdrig/$(notdir $(MODULE)) >depends
	sed -e "s/@VERSION@/$(VERSION)/; s/@ARCH@/$(DEB_ARCH)/" \
	    -e "s/@DEPENDS@/$$(sed 's/^shlibs:Depends=//' build/deb/depends)/" \
	    board/debian/control >build/deb/root/DEBIAN/control
	dpkg-deb --root-owner-group -b build/deb/root build/hdrig_$(VERSION)_$(DEB_ARCH).deb

# On all cores, unless make was told otherwise.
PARALLEL = $(if $(findstring -j,$(MAKEFLAGS)),,-j$(shell nproc))
demo:
	@$(MAKE) -s $(PARALLEL) all
	@echo "a simulated room, photographed by a rig of 9 cameras at three exposures"
	@build/hdrig simulate --kind room --seed $(DEMO) --views 9 --size 336 --samples 4 \
	    --out out/rig
	@echo "becomes an HDR scene; where the cameras stood is not told"
	@build/hdrig reconstruct --images out/rig --rig none --size 336 --refine 400 --out out/latest
	@echo "compared with photographs of places and exposures that it has not seen:"
	@build/hdrig eval --data out/rig --rig none --scene out/latest
	@echo
	@echo "out/latest: scene.ply for viewers of Gaussian splats, hdr/*.exr and ldr/*.png, report.html"
	@echo "look at it: open out/latest/view.html in a browser, or build/hdrig view out/latest"

# The picture of README.md: 17 camera positions (a: inputs, b: held out), one exposure each.
PICTURE := out/picture
PHOTOS := a_000_0 b_000_1 a_001_2 b_001_3 a_002_4 b_002_1 a_003_0 b_003_3 a_004_2 b_004_1 \
	a_005_4 b_005_3 a_006_0 b_006_1 a_007_2 b_007_3 a_008_4
SHOWN := inputs/a_000_0 inputs/b_002_1 inputs/b_005_3 inputs/a_008_4 \
	$(addsuffix /frame_0005,ev-3 ev0 ev2 false)
LOOK := build/hdrig render --scene $(PICTURE)/scene --path orbit --frames 8
picture: all $(B)/tests/e2e/picture
	build/hdrig simulate --kind room --seed 5 --views 9 --size 448 --samples 4 --spread 0.2 \
	    --out $(PICTURE)/world
	rm -rf $(PICTURE)/inputs && mkdir $(PICTURE)/inputs
	for p in $(PHOTOS); do \
	    name=$$(echo $$p | sed 's/a_/train_ldr_/; s/b_/test_ldr_/'); \
	    cp $(PICTURE)/world/images/$$name.png $(PICTURE)/inputs/$$p.png || exit; done
	sed 's/train_ldr_/a_/; s/test_ldr_/b_/' $(PICTURE)/world/exposure.json \
	    >$(PICTURE)/inputs/exposure.json
	build/hdrig reconstruct --images $(PICTURE)/inputs --rig none --out $(PICTURE)/scene
	for ev in -3 0 2; do $(LOOK) --ev $$ev --out $(PICTURE)/ev$$ev || exit; done
	$(LOOK) --false-colour --out $(PICTURE)/false
	$(B)/tests/e2e/picture tests/data/readme.png 1008 4 $(SHOWN:%=$(PICTURE)/%.png)

bench: all
	build/hdrig bench --what all

# --- tests ----------------------------------------------------------------------------------------
check: deps-check
	@tests/check.sh check

check-long: deps-check
	@tests/check.sh long

test: deps-check
	@tests/check.sh test

lint: deps-check
	@tests/check.sh lint

check-kernel: deps-kernel deps-check $(TOOLS) $(MODULE) $(call programs,$(LINUX)) \
	$(B)/tests/e2e/verify_take
	@tests/linux/run.sh $(B)/tests/linux $(TEST)

check-rig: deps-check all $(B)/tests/e2e/verify_take
	@rm -rf build/e2e/check-rig && mkdir -p build/e2e/check-rig
	@HDRIG=$(B)/hdrig BIN=$(B)/tests/e2e OUT=build/e2e/check-rig tests/rig/check.sh

check-mpi: deps-check all
	@rm -rf build/e2e/check-mpi && mkdir -p build/e2e/check-mpi
	@HDRIG=$(B)/hdrig OUT=build/e2e/check-mpi tests/ranks/check.sh

check-distro:
	@tests/distro.sh "$(SUITE)"

check-train: all libsim
	@rm -rf build/train && mkdir -p build/train
	@HDRIG=build/hdrig OUT=build/train timeout 900 tests/train.sh

tests: $(call programs,$(TESTS) $(E2E))
# For the warnings of a second compiler: CC=clang CFLAGS=-fsyntax-only
objects: deps $(MODULE) $(call objects,$(CORE) $(DRIVERS) $(FIRMWARE) $(SIM) $(MAINS) \
	$(TESTS) $(E2E))
edge-tests: $(EDGE_PROGRAMS)
inner-tests: $(INNER_PROGRAMS)
tsan-tests: $(TSAN_PROGRAMS)
arm-tests: $(ARM_PROGRAMS)
fault-tests: $(call programs,$(FAULT))
fuzz-targets: $(call programs,$(FUZZ))

# Hundreds of programs: lld links them in a fifth of the time.
TEST_LINK = $(CC) $(FLAGS) -fuse-ld=lld $^ $(LDLIBS)
$(B)/tests/%_test: $(B)/tests/%_test.o $(LIBS)
	$(TEST_LINK) -lcmocka -o $@

# Jobs with the network that comes with the program.
$(B)/tests/unit/firmware/recon/plan_test: | build/small.hdrig

# The module over imitations of libcamera 0.0.3 and 0.7.2.
FAKE := $(B)/tests/unit/drivers/device
FAKECAMERAS := $(FAKE)/fakecamera_3.so $(FAKE)/fakecamera_72.so
$(FAKE)/camera_libcamera_test $(B)/tests/unit/firmware/capture/session_focus_test: | $(FAKECAMERAS)
$(FAKECAMERAS): $(FAKE)/fakecamera_%.so: $(MODULE_NEEDS) \
		$(wildcard $(addprefix tests/unit/drivers/device/fakecamera/,*.* libcamera/*))
	@mkdir -p $(@D)
	$(CXX) $(CXXFLAGS_MODULE) -Itests/unit/drivers/device/fakecamera -DFAKE_RELEASE=$* \
	    -Dclock_gettime=fakecamera_clock -o $@ $(filter %.cpp,$^)

# Each imitates one version of the library.
$(FAKE)/trigger_gpiod1_test.o: MORE = -Itests/unit/drivers/device/fakegpiod1
$(FAKE)/trigger_gpiod2_test.o: MORE = -Itests/unit/drivers/device/fakegpiod2

# What the scripts there call.
$(B)/tests/e2e/%: $(B)/tests/e2e/%.o $(LIBS)
	$(TEST_LINK) -o $@

$(B)/tests/linux/usbcam: $(B)/tests/linux/uvc.o
$(B)/tests/linux/%: $(B)/tests/linux/%.o $(LIBS)
	$(CC) $(FLAGS) $^ $(LDLIBS) -o $@

# malloc of the whole program, so not together with a sanitizer.
$(call programs,$(FAULT)): $(B)/tests/fault/alloc_fail.o

# libFuzzer brings its own main.
FUZZ_MAIN := $(if $(findstring fuzzer,$(SAN)),,$(B)/tests/fuzz/replay_main.o)
$(B)/tests/fuzz/fuzz_%: $(B)/tests/fuzz/fuzz_%.o $(FUZZ_MAIN) $(LIBS)
	$(TEST_LINK) -o $@

# tests/arm/cmocka.h stands in for the library, which Debian has for the native machine only.
# gcc 12 for Arm fails to vectorise a sum in nn_test.
$(B)/tests/arm/%_test: tests/%_test.c $(B)/libcore.a tests/arm/cmocka.h Makefile
	@mkdir -p $(@D)
	$(CC) $(FLAGS) -fno-tree-vectorize -Itests/arm -static $(filter %.c %.a,$^) -lm -o $@

fuzz: deps-check
	$(MAKE) CC=clang SAN=fuzzer,address,undefined fuzz-targets
	@tests/fuzz.sh $(SECONDS)

format:
	clang-format -i $(wildcard $(addsuffix /*/*.[ch],core drivers firmware sim tests) drivers/*/*.?pp \
	    tests/unit/*/*/*.[ch] tests/unit/drivers/device/fakecamera/*.*)

# A value for scripts: make -s print-B
print-%: ; @echo $($*)

# --- packages -------------------------------------------------------------------------------------
deps: build/deps
deps-check: build/deps-check build/axe.min.js
deps-kernel: build/deps-kernel
deps-qemu: build/deps-qemu
deps-cross: build/deps-cross
build/deps: NEED := $(DEPS)
build/deps-check: NEED := $(DEPS_CHECK)
build/deps-kernel: NEED := $(DEPS_KERNEL)
build/deps-qemu: NEED := $(DEPS_QEMU)
build/deps-cross: NEED := $(DEPS_CROSS)

build/deps build/deps-check build/deps-kernel build/deps-qemu build/deps-cross: Makefile
	@mkdir -p build
	@command -v dpkg-query >/dev/null || { \
	    echo "not a Debian system, assuming that these are here: $(NEED)"; touch $@; exit 0; }; \
	missing=$$(for p in $(NEED); do \
	    dpkg-query -W -f='$${db:Status-Status}' $$p 2>/dev/null | grep -qx installed || \
	        echo $$p; done); \
	test -z "$$missing" || { \
	    echo "installing packages:" $$missing; \
	    test $$(id -u) = 0 || command -v sudo >/dev/null || { \
	        echo "neither root nor sudo; have an administrator run: apt-get install" $$missing; \
	        exit 1; }; \
	    root=$$(test $$(id -u) = 0 || echo sudo); \
	    $$root apt-get -q update && $$root env DEBIAN_FRONTEND=noninteractive \
	        apt-get -q install -y --no-install-recommends $$missing; } && touch $@

build/axe.min.js: tests/npm.sh Makefile | build/deps-check
	@tests/npm.sh $(AXE) $(AXE_SHA256) package/axe.min.js $@

clean:
	rm -rf build

-include $(shell find build/$(V) -name '*.d' 2>/dev/null)
