CREATE TABLE public.budgets (
    result_id integer NOT NULL,
    quantity text NOT NULL,
    source text NOT NULL,
    std double precision NOT NULL
);
CREATE TABLE public.causes (
    result_id integer NOT NULL,
    "position" integer NOT NULL,
    effect text NOT NULL,
    specimen text,
    probability double precision NOT NULL,
    parameters jsonb NOT NULL
);
CREATE TABLE public.diagnoses (
    result_id integer NOT NULL,
    verdict text NOT NULL
);
CREATE TABLE public.estimates (
    result_id integer NOT NULL,
    quantity text NOT NULL,
    value double precision NOT NULL,
    std double precision
);
CREATE TABLE public.femu_piezo_version (
    version_num character varying(32) NOT NULL
);
CREATE TABLE public.inputs (
    result_id integer NOT NULL,
    "position" integer NOT NULL,
    specimen_id integer NOT NULL,
    sweep_id integer
);
CREATE TABLE public.lots (
    id integer NOT NULL,
    name text NOT NULL
);
CREATE SEQUENCE public.lots_id_seq
    AS integer
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.lots_id_seq OWNED BY public.lots.id;
CREATE TABLE public.results (
    id integer NOT NULL,
    piece character varying(64) NOT NULL,
    assumed character varying(64) NOT NULL,
    step text NOT NULL,
    program text NOT NULL,
    lot_id integer,
    name text NOT NULL,
    status text NOT NULL,
    reason text NOT NULL,
    written timestamp without time zone NOT NULL,
    columns jsonb NOT NULL,
    record jsonb
);
CREATE SEQUENCE public.results_id_seq
    AS integer
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.results_id_seq OWNED BY public.results.id;
CREATE TABLE public.specimens (
    id integer NOT NULL,
    hash character varying(64) NOT NULL,
    name text NOT NULL,
    description jsonb
);
CREATE SEQUENCE public.specimens_id_seq
    AS integer
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.specimens_id_seq OWNED BY public.specimens.id;
CREATE TABLE public.sweeps (
    id integer NOT NULL,
    hash character varying(64) NOT NULL,
    file text NOT NULL,
    measured timestamp without time zone NOT NULL
);
CREATE SEQUENCE public.sweeps_id_seq
    AS integer
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.sweeps_id_seq OWNED BY public.sweeps.id;
ALTER TABLE ONLY public.lots ALTER COLUMN id SET DEFAULT nextval('public.lots_id_seq'::regclass);
ALTER TABLE ONLY public.results ALTER COLUMN id SET DEFAULT nextval('public.results_id_seq'::regclass);
ALTER TABLE ONLY public.specimens ALTER COLUMN id SET DEFAULT nextval('public.specimens_id_seq'::regclass);
ALTER TABLE ONLY public.sweeps ALTER COLUMN id SET DEFAULT nextval('public.sweeps_id_seq'::regclass);
INSERT INTO public.budgets VALUES (1, 's11', 'noise', 3e-14);
INSERT INTO public.budgets VALUES (1, 's11', 'geometry', 4e-14);
INSERT INTO public.budgets VALUES (1, 's11_tan', 'noise', 0.0001);
INSERT INTO public.budgets VALUES (2, 's11', 'noise', 3e-14);
INSERT INTO public.budgets VALUES (2, 's11', 'geometry', 4e-14);
INSERT INTO public.budgets VALUES (2, 's11_tan', 'noise', 0.0001);
INSERT INTO public.estimates VALUES (1, 's11', 1.65e-11, 5e-14);
INSERT INTO public.estimates VALUES (1, 's11_tan', 0.015, 0.0001);
INSERT INTO public.estimates VALUES (1, 'k_eff', 0.35, NULL);
INSERT INTO public.estimates VALUES (2, 's11', 1.65e-11, 5e-14);
INSERT INTO public.estimates VALUES (2, 's11_tan', 0.015, 0.0001);
INSERT INTO public.estimates VALUES (2, 'k_eff', 0.35, NULL);
INSERT INTO public.femu_piezo_version VALUES ('1');
INSERT INTO public.inputs VALUES (1, 0, 1, 1);
INSERT INTO public.inputs VALUES (2, 0, 1, 2);
INSERT INTO public.lots VALUES (1, 'old');
INSERT INTO public.results VALUES (1, '8456dd199ce601ecff88dccf6b486bf4090bcf896525885c3157dd05ea9ce835', '5adb8c3d42601f14dc3c467830d23dcc75ffae17236d02c6bb26c6e31b1c3c8e', 'update', '0.1.0+old', 1, 'p1.csv', 'ok', '', '2026-01-05 08:00:00', '{"s11": 0.0000000000165, "k_eff": 0.35, "s11_std": 0.00000000000005, "s11_tan": 0.015, "s11_tan_std": 0.0001}', '{"causes": [], "parameters": {"s11": {"std": 0.00000000000005, "tan": 0.015, "value": 0.0000000000165, "budget": {"noise": 0.00000000000003, "geometry": 0.00000000000004}, "tan_std": 0.0001, "tan_budget": {"noise": 0.0001}}}}');
INSERT INTO public.results VALUES (2, '26e2cf3ad9b36185a672551c930c05074396613046203ecbc8e21536be64ee28', '5adb8c3d42601f14dc3c467830d23dcc75ffae17236d02c6bb26c6e31b1c3c8e', 'update', '0.1.0+old', 1, 'p2.csv', 'ok', '', '2026-01-05 08:00:00', '{"s11": 0.0000000000165, "k_eff": 0.35, "s11_std": 0.00000000000005, "s11_tan": 0.015, "s11_tan_std": 0.0001}', '{"causes": [], "parameters": {"s11": {"std": 0.00000000000005, "tan": 0.015, "value": 0.0000000000165, "budget": {"noise": 0.00000000000003, "geometry": 0.00000000000004}, "tan_std": 0.0001, "tan_budget": {"noise": 0.0001}}}}');
INSERT INTO public.specimens VALUES (1, 'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa', 'plate', '{"name": "plate", "geometry": {"shape": "plate"}}');
INSERT INTO public.sweeps VALUES (1, 'aca2a6a484b2fddc12ddff94523e93fe616ee576f5240d26c7cf86574583ee5e', 'p1.csv', '2026-01-05 08:00:00');
INSERT INTO public.sweeps VALUES (2, '1e6029c1ab54ea43e092313074f888e8b342761024d0be16c3cf4e98e5b733e9', 'p2.csv', '2026-01-05 08:00:00');
SELECT pg_catalog.setval('public.lots_id_seq', 1, true);
SELECT pg_catalog.setval('public.results_id_seq', 2, true);
SELECT pg_catalog.setval('public.specimens_id_seq', 1, true);
SELECT pg_catalog.setval('public.sweeps_id_seq', 2, true);
ALTER TABLE ONLY public.budgets
    ADD CONSTRAINT budgets_pkey PRIMARY KEY (result_id, quantity, source);
ALTER TABLE ONLY public.causes
    ADD CONSTRAINT causes_pkey PRIMARY KEY (result_id, "position");
ALTER TABLE ONLY public.diagnoses
    ADD CONSTRAINT diagnoses_pkey PRIMARY KEY (result_id);
ALTER TABLE ONLY public.estimates
    ADD CONSTRAINT estimates_pkey PRIMARY KEY (result_id, quantity);
ALTER TABLE ONLY public.femu_piezo_version
    ADD CONSTRAINT femu_piezo_version_pkc PRIMARY KEY (version_num);
ALTER TABLE ONLY public.inputs
    ADD CONSTRAINT inputs_pkey PRIMARY KEY (result_id, "position");
ALTER TABLE ONLY public.lots
    ADD CONSTRAINT lots_name_key UNIQUE (name);
ALTER TABLE ONLY public.lots
    ADD CONSTRAINT lots_pkey PRIMARY KEY (id);
ALTER TABLE ONLY public.results
    ADD CONSTRAINT results_piece_assumed_step_program_key UNIQUE (piece, assumed, step, program);
ALTER TABLE ONLY public.results
    ADD CONSTRAINT results_pkey PRIMARY KEY (id);
ALTER TABLE ONLY public.specimens
    ADD CONSTRAINT specimens_hash_key UNIQUE (hash);
ALTER TABLE ONLY public.specimens
    ADD CONSTRAINT specimens_pkey PRIMARY KEY (id);
ALTER TABLE ONLY public.sweeps
    ADD CONSTRAINT sweeps_hash_key UNIQUE (hash);
ALTER TABLE ONLY public.sweeps
    ADD CONSTRAINT sweeps_pkey PRIMARY KEY (id);
ALTER TABLE ONLY public.budgets
    ADD CONSTRAINT budgets_result_id_fkey FOREIGN KEY (result_id) REFERENCES public.results(id) ON DELETE CASCADE;
ALTER TABLE ONLY public.causes
    ADD CONSTRAINT causes_result_id_fkey FOREIGN KEY (result_id) REFERENCES public.results(id) ON DELETE CASCADE;
ALTER TABLE ONLY public.diagnoses
    ADD CONSTRAINT diagnoses_result_id_fkey FOREIGN KEY (result_id) REFERENCES public.results(id) ON DELETE CASCADE;
ALTER TABLE ONLY public.estimates
    ADD CONSTRAINT estimates_result_id_fkey FOREIGN KEY (result_id) REFERENCES public.results(id) ON DELETE CASCADE;
ALTER TABLE ONLY public.inputs
    ADD CONSTRAINT inputs_result_id_fkey FOREIGN KEY (result_id) REFERENCES public.results(id) ON DELETE CASCADE;
ALTER TABLE ONLY public.inputs
    ADD CONSTRAINT inputs_specimen_id_fkey FOREIGN KEY (specimen_id) REFERENCES public.specimens(id);
ALTER TABLE ONLY public.inputs
    ADD CONSTRAINT inputs_sweep_id_fkey FOREIGN KEY (sweep_id) REFERENCES public.sweeps(id);
ALTER TABLE ONLY public.results
    ADD CONSTRAINT results_lot_id_fkey FOREIGN KEY (lot_id) REFERENCES public.lots(id);
